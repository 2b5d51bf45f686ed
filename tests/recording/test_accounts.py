"""The accounts of a take: nodes that agreed on their first frame, and those for which it is taken from what came."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from mocapella.recording.accounts import Accounts
from mocapella.recording.ledger import LedgerRow, NodeLedger

ASKED, SILENT = ("front", 1), ("side", 2)


def rows(accounts: Accounts) -> dict[str, LedgerRow]:
    return {row.sensor: row for row in (msgspec.json.decode(one, type=LedgerRow) for one in accounts.take_rows())}


@given(st.lists(st.integers(0, 50), min_size=1, max_size=10, unique=True))
def test_the_first_frame_that_came_is_the_first_of_a_node_that_answered_nothing(numbers: list[int]) -> None:
    accounts = Accounts({})
    for number in numbers:
        assert accounts.wants(SILENT, number)
        accounts.receive(SILENT, number)
    assert rows(accounts) == {}  # nothing is agreed
    accounts.agree_on_all()
    first = min(numbers)
    assert rows(accounts) == {"side": LedgerRow(*SILENT, first=first, heard=max(numbers) + 1)}
    accounts.commit()
    assert accounts.lost.get("side", 0) == max(numbers) + 1 - first - len(numbers)
    assert not first or not accounts.wants(SILENT, first - 1)  # an earlier one belongs to the take no more


def test_a_node_that_agreed_keeps_its_first_frame_and_has_no_new_row() -> None:
    accounts = Accounts({})
    accounts.change(ASKED, lambda ledger: ledger.expect(3))
    accounts.receive(ASKED, 5)
    assert rows(accounts)["front"].first == 3
    accounts.agree_on_all()
    assert rows(accounts) == {}
    assert accounts.nodes[ASKED].first == 3


def test_a_frame_that_comes_twice_is_a_duplicate_and_waits_for_the_disk_once() -> None:
    accounts = Accounts({})
    assert accounts.wants(SILENT, 7)
    accounts.receive(SILENT, 7)
    assert not accounts.wants(SILENT, 7)
    accounts.receive(SILENT, 7)
    assert (accounts.duplicates, accounts.pending, accounts.stored) == (1, 1, 0)
    accounts.commit()
    assert (accounts.pending, accounts.stored, accounts.frames) == (0, 1, {"side": 1})


def test_at_the_end_nodes_with_an_unknown_end_have_a_row_and_others_only_if_something_changed() -> None:
    accounts = Accounts({})
    for node in (ASKED, SILENT):
        accounts.change(node, lambda ledger: ledger.expect(0))
    accounts.change(ASKED, lambda ledger: ledger.finish(0))
    assert set(rows(accounts)) == {"front", "side"}
    assert set(rows(accounts)) == set()
    last = [msgspec.json.decode(one, type=LedgerRow).sensor for one in accounts.take_rows(last=True)]
    assert last == ["side"]


def test_frames_that_a_failed_disk_has_lost_are_pending_again() -> None:
    accounts = Accounts({})
    for node, count in ((ASKED, 5), (SILENT, 3)):
        for number in range(count):
            accounts.wants(node, number)
            accounts.receive(node, number)
    accounts.commit()
    accounts.wants(ASKED, 5)
    accounts.receive(ASKED, 5)
    read_back = NodeLedger()
    for number in range(4):
        read_back.put_back(number)
    read_back.commit()
    accounts.recount({ASKED: read_back})
    assert (accounts.frames, accounts.stored, accounts.pending) == ({"front": 4}, 4, 5)  # 2 of the one, 3 of the other
