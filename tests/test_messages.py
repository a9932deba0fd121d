"""What a person reads about bad input: what was found is always in it.

The page `messages` of the documentation lists them all.
"""

from error_messages import messages

from jaxest.cli.output import _GUIDED as GUIDED
from jaxest.cli.output import next_step


def test_messages_say_what_was_found():
    found = list(messages())
    assert len(found) > 200
    mute = [m for m in found if "{" not in m.text and ":" not in m.text[:40] and m.text[0] != "["]
    assert not mute, "\n".join(f"{m.place}: {m.text}" for m in mute)


def test_messages_are_one_sentence_without_shouting():
    for message in messages():
        assert not message.text.endswith((".", "!")), message
        assert "  " not in message.text, message


def test_what_to_do_next_is_said_once(tmp_path):
    """Either the message says it, or the command adds a line; the options name the file that the message is about."""
    log = tmp_path / "log.csv"
    log.write_text("x")
    for message in messages():
        text = message.text.replace("{path}", str(log))
        added = next_step(text, "estimate", {"log": log})
        assert bool(added) != bool(GUIDED.search(text)), message
        assert added in ("", f"; `jaxest inspect {log}` shows what is in it") or not text.startswith(str(log)), message
    assert (
        next_step(f"{log}: the file is empty", "estimate", {"log": log})
        == f"; `jaxest inspect {log}` shows what is in it"
    )
    assert "jaxest inspect --help" in next_step(f"{log}: the file is empty", "inspect", {"file": log})
    assert next_step("rod 'a' does not exist; did you mean 'b'?", "tune", {}) == ""
