"""What a person sees while something long runs and standard error is a log or a pipe."""

import time

from jaxest.cli import output


def test_a_line_now_and_then_and_none_for_what_is_short(monkeypatch, capsys):
    with output.working("tuning ...") as say:
        say("evaluation 1")
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(output, "PATIENCE", 0.01)
    with output.working("tuning ...") as say:
        say("evaluation 2")
        seen = ""
        while "evaluation 2\n" not in seen:
            time.sleep(0.01)
            seen += capsys.readouterr().err
    assert capsys.readouterr().out == ""
    assert all(line.endswith((": evaluation 2", ": tuning ...")) for line in seen.splitlines())
