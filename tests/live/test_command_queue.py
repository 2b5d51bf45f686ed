"""Laws of the queue of commands."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from mocapella.live.command_queue import CommandQueue, client_of
from mocapella.model.limits import COMMANDS_A_SECOND, COMMANDS_AT_ONCE, MOST_COMMANDS, MOST_COMMANDS_OF_A_CLIENT


class FakeAnswer:
    def __init__(self, client: str) -> None:
        self.client = client
        self.got: list[bytes] = []

    def __call__(self, data: bytes) -> None:
        self.got.append(data)


@given(st.lists(st.tuples(st.sampled_from(["a", "b", "c", "d", "e", ""]), st.integers(1, 30)), max_size=12))
def test_no_client_has_more_than_its_share_and_the_order_is_kept(runs: list[tuple[str, int]]) -> None:
    sent = [(client, k // 2) for client, count in runs for k in range(count)]
    queue, taken, waiting = CommandQueue(clock_ns=lambda: 0), list[tuple[str, int]](), Counter[str]()
    for client, number in sent:
        refusal = queue.put("name", {"person": number}, FakeAnswer(client))
        full = waiting[client] >= MOST_COMMANDS_OF_A_CLIENT or waiting.total() >= MOST_COMMANDS
        assert bool(refusal) == full
        if not full:
            waiting[client] += 1
            taken.append((client, number))
    assert queue.refused == len(sent) - len(taken)
    got = list[tuple[str, int]]()
    while (command := queue.take()) is not None:
        got += [(answer.client, command.arguments["person"]) for answer in command.answers]  # type: ignore[attr-defined]
    assert got == taken
    assert queue.put("start", {}, FakeAnswer("a")) == ""  # there is room again


def test_what_a_client_sends_several_times_in_a_row_is_carried_out_once_and_answered_each_time() -> None:
    queue, answers = CommandQueue(), [FakeAnswer("a") for _ in range(3)]
    for answer in answers:
        queue.put("recalibrate", {}, answer)
    queue.put("recalibrate", {}, FakeAnswer("b"))
    command = queue.take()
    assert command is not None
    command.answer(b"done")
    assert [answer.got for answer in answers] == [[b"done"]] * 3
    assert queue.take() is not None  # that of another client is another command
    assert queue.take() is None


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 40), st.floats(0.0, 3.0)), max_size=20))
def test_a_client_that_sends_without_end_has_its_commands_carried_out_at_a_limited_rate(
    runs: list[tuple[str, int, float]],
) -> None:
    now_s, taken = 0.0, list[tuple[str, int, float]]()
    queue, number = CommandQueue(clock_ns=lambda: round(1e9 * now_s)), 0
    for client, count, pause_s in [*runs, *[("a", 0, 1.0)] * 10]:
        for _ in range(count):
            number += not queue.put("name", {"person": number}, FakeAnswer(client))
        while (command := queue.take()) is not None:
            taken.append((client_of(command.answers[0]), command.arguments["person"], now_s))
        now_s += pause_s
    assert sorted(person for _, person, _ in taken) == list(range(number))  # none is lost
    for client in "ab":
        own = [(person, at_s) for name, person, at_s in taken if name == client]
        assert own == sorted(own)
        for k, (_, first_s) in enumerate(own):
            for n, (_, last_s) in enumerate(own[k:], 1):
                assert n <= COMMANDS_AT_ONCE + COMMANDS_A_SECOND * (last_s - first_s) + 1e-6


def test_other_clients_overtake_one_that_has_sent_many_commands() -> None:
    queue = CommandQueue(clock_ns=lambda: 0)
    for number in range(COMMANDS_AT_ONCE):
        queue.put("name", {"person": number}, FakeAnswer("flood"))
    assert all(queue.take() is not None for _ in range(COMMANDS_AT_ONCE))
    queue.put("recalibrate", {}, FakeAnswer("flood"))
    queue.put("record", {}, FakeAnswer("other"))
    command = queue.take()
    assert command is not None
    assert command.verb == "record"
    assert queue.take() is None


def test_programs_without_a_name_are_not_taken_for_one() -> None:
    queue = CommandQueue()
    for _ in range(2):
        queue.put("stop", {}, FakeAnswer(""))
    assert [queue.take() is not None for _ in range(3)] == [True, True, False]
