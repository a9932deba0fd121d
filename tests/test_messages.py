"""What a person reads about bad input: what was found is always in it.

The page `messages` of the documentation lists them all.
"""

from error_messages import messages


def test_messages_say_what_was_found():
    found = list(messages())
    assert len(found) > 200
    mute = [m for m in found if "{" not in m.text and ":" not in m.text[:40] and m.text[0] != "["]
    assert not mute, "\n".join(f"{m.place}: {m.text}" for m in mute)


def test_messages_are_one_sentence_without_shouting():
    for message in messages():
        assert not message.text.endswith((".", "!")), message
        assert "  " not in message.text, message
