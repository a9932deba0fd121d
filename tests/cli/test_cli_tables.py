import pytest

from jaxest.cli.tables import figures, number, speed
from jaxest.io.report import Row


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (5.0, "5"), (0.1 + 0.2, "0.300"), (99.96, "100"), (285.714, "286"), (12345.678, "12346"),
        (1e-9, "1.00e-09"), (1e7, "1.00e+07"), (-3.14159, "-3.14"), (float("nan"), "nan"), (None, ""),
    ],
)  # fmt: skip
def test_number(value, text):
    assert number(value) == text


def test_speed():
    assert "12 x faster" in speed(12.3)
    assert "4 x slower" in speed(0.25)
    assert speed(None) == ""


def test_empty_columns_are_left_out():
    table = figures([Row("a", "", 1.0, "s"), Row("b", "", 2.0, "s", n=3)])
    assert [column.header for column in table.columns] == ["metric", "value", "n"]
