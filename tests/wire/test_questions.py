"""Questions and answers of cameras: there and back, and the sizes up to which they are read."""

from __future__ import annotations

import pytest

from mocapella.errors import WireError
from mocapella.wire.questions import (
    MAX_ANSWER_BYTES,
    MAX_QUESTION_BYTES,
    AskPicture,
    NodeAnswer,
    read_answer,
    read_question,
    write_answer,
    write_question,
)


def test_a_question_is_read_up_to_its_limit() -> None:
    data = write_question(AskPicture(scale=0.5))
    assert read_question(data) == AskPicture(scale=0.5)
    assert read_question(data.ljust(MAX_QUESTION_BYTES)) == AskPicture(scale=0.5)
    with pytest.raises(WireError, match=f"at most {MAX_QUESTION_BYTES}"):
        read_question(data.ljust(MAX_QUESTION_BYTES + 1))


def test_a_question_may_have_64_kib_and_an_answer_8_mib() -> None:
    """As docs/wire.md promises to programs of others."""
    question, answer = write_question(AskPicture()), write_answer(NodeAnswer(True))
    read_question(question.ljust(65_536))
    read_answer(answer.ljust(8_388_608))
    with pytest.raises(WireError, match="has 65537 bytes"):
        read_question(question.ljust(65_537))
    with pytest.raises(WireError, match="has 8388609 bytes"):
        read_answer(answer.ljust(8_388_609))


def test_an_answer_is_read_up_to_its_limit_which_leaves_room_for_a_picture() -> None:
    answer = NodeAnswer(True, "x" * 6_000_000)
    data = write_answer(answer)
    assert read_answer(data) == answer
    assert read_answer(data.ljust(MAX_ANSWER_BYTES)) == answer
    with pytest.raises(WireError, match=f"at most {MAX_ANSWER_BYTES}"):
        read_answer(data.ljust(MAX_ANSWER_BYTES + 1))


def test_an_answer_beyond_the_limit_is_a_refusal_with_a_remedy() -> None:
    room = MAX_ANSWER_BYTES - len(write_answer(NodeAnswer(True, "x"))) + 1
    assert len(write_answer(NodeAnswer(True, "x" * room))) == MAX_ANSWER_BYTES
    refusal = read_answer(write_answer(NodeAnswer(True, "x" * (room + 1))))
    assert not refusal.ok
    assert "ask for jpeg, or with a smaller scale" in refusal.message


def test_a_description_that_no_control_has_is_no_answer() -> None:
    control = b'{"name":"gain","unit":"","least":%d,"most":9,"step":1,"default":0,"value":1}'
    good, bad = (b'{"ok":true,"descriptions":[' + control % least + b"]}" for least in (0, 10))
    descriptions = read_answer(good).descriptions
    assert descriptions is not None
    assert descriptions[0].most == 9.0
    with pytest.raises(WireError, match="least is 10"):
        read_answer(bad)
