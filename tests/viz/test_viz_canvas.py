"""What all pictures share."""

import pytest

from jaxest.io.report import Row
from jaxest.viz import canvas

pytest.importorskip("matplotlib")


def test_bars_stand_beside_their_references(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(canvas, "write", lambda path, figure: drawn.append(figure))
    rows = [
        Row("error", "ours", 1.0, "mm", 0.1, reference=3.0, reference_name="paper"),
        Row("error", "both", 2.0, "mm"),
    ]
    canvas.bars(tmp_path / "a.png", rows)
    canvas.bars(tmp_path / "b.png", [row._replace(metric=f"{row.condition} error") for row in rows[1:] + rows])
    (axis,), (named,) = (figure.axes for figure in drawn)
    assert [round(patch.get_width(), 3) for patch in axis.patches[:4]] == [1.0, 3.0, 2.0, 0.0]
    assert [text.get_text() for text in axis.get_yticklabels()] == ["ours", "both"]
    assert axis.get_xlabel() == "error [mm]"
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["jaxest", "paper"]
    assert [text.get_text() for text in named.get_yticklabels()] == ["both error", "ours error", "both error"]
