"""HOTA, IDF1 and identity switches: laws, and sequences that can be counted by hand."""

from __future__ import annotations

from collections import Counter
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.evaluation.identity import IdentityFrame, hota, identity_switches, idf1, similarity


def frame(true: list[int], found: list[int], pairs: dict[tuple[int, int], float]) -> IdentityFrame:
    """Similarities by (true id, found id); 0 elsewhere."""
    s = np.array([[pairs.get((t, f), 0.0) for f in found] for t in true]).reshape(len(true), len(found))
    return IdentityFrame(tuple(true), tuple(found), s)


@st.composite
def sequences(draw: st.DrawFn) -> list[IdentityFrame]:
    people, length = draw(st.integers(1, 4)), draw(st.integers(1, 8))
    subsets = st.sets(st.integers(0, people - 1)).map(sorted)
    frames = []
    for _ in range(length):
        true, found = draw(subsets), draw(subsets)
        values = draw(st.lists(st.floats(0, 1), min_size=len(true) * len(found), max_size=len(true) * len(found)))
        s = np.array(values).reshape(len(true), len(found))
        frames.append(IdentityFrame(tuple(true), tuple(f + 10 for f in found), s))
    return frames


@given(sequences())
def test_a_perfect_result_is_one_without_a_switch(frames: list[IdentityFrame]) -> None:
    perfect = [IdentityFrame(f.true_ids, tuple(i + 100 for i in f.true_ids), np.eye(len(f.true_ids))) for f in frames]
    scored = hota(perfect)
    assert (scored.hota, scored.detection, scored.association) == pytest.approx((1, 1, 1))
    assert idf1(perfect) == 1.0
    assert identity_switches(perfect) == 0


@given(sequences(), st.permutations(range(10, 14)), st.permutations(range(4)))
def test_what_the_ids_are_called_does_not_matter(
    frames: list[IdentityFrame], found_names: list[int], true_names: list[int]
) -> None:
    renamed = [
        IdentityFrame(
            tuple(true_names[i] for i in f.true_ids), tuple(found_names[i - 10] for i in f.found_ids), f.similarity
        )
        for f in frames
    ]
    assert idf1(renamed) == pytest.approx(idf1(frames))
    distinct = np.concatenate([f.similarity.reshape(-1) for f in frames])
    if len(np.unique(distinct)) == len(distinct):  # ties are broken by the order
        assert hota(renamed).hota == pytest.approx(hota(frames).hota)
        assert identity_switches(renamed) == identity_switches(frames)


@given(sequences())
def test_figures_are_between_zero_and_one(frames: list[IdentityFrame]) -> None:
    scored = hota(frames)
    for value in (scored.hota, scored.detection, scored.association, idf1(frames)):
        assert 0 <= value <= 1 + 1e-12
    assert identity_switches(frames) >= 0


def test_one_person_whose_id_changes_at_the_half() -> None:
    frames = [frame([0], [1 if t < 5 else 2], {(0, 1): 1.0, (0, 2): 1.0}) for t in range(10)]
    scored = hota(frames)
    assert scored.detection == 1.0
    assert scored.association == 0.5  # of each match, 5 of the 10 frames in which either id is there
    assert scored.hota == pytest.approx(np.sqrt(0.5))
    assert idf1(frames) == pytest.approx(2 * 5 / 20)
    assert identity_switches(frames) == 1


def test_two_people_who_swap_ids_are_two_switches() -> None:
    straight = frame([0, 1], [5, 6], {(0, 5): 1.0, (1, 6): 1.0})
    crossed = frame([0, 1], [5, 6], {(0, 6): 1.0, (1, 5): 1.0})
    frames = [straight] * 3 + [crossed] * 1
    assert identity_switches(frames) == 2
    assert idf1(frames) == pytest.approx(2 * 6 / 16)
    assert hota(frames).association == pytest.approx((6 * 3 / 5 + 2 * 1 / 7) / 8)


def test_a_person_lost_and_found_under_the_same_id_is_no_switch() -> None:
    seen, lost = frame([0], [7], {(0, 7): 0.9}), frame([0], [], {})
    assert identity_switches([seen, lost, seen]) == 0
    assert idf1([seen, lost, seen]) == pytest.approx(2 * 2 / 5)
    assert identity_switches([seen, lost, frame([0], [8], {(0, 8): 0.9})]) == 1


def test_alphas_count_by_how_near_the_match_is() -> None:
    frames = [frame([0], [1], {(0, 1): 0.5})] * 4
    scored = hota(frames)  # a match at α = 0.05, 0.10, …, 0.50: 10 of 19; else one miss and one false positive
    assert scored.hota == pytest.approx(10 / 19)


@pytest.mark.parametrize("twentieths", range(21))
def test_a_match_counts_at_each_twentieth_up_to_its_similarity(twentieths: int) -> None:
    """Of the 19 from 0.05 to 0.95, as HOTA's authors average it."""
    scored = hota([frame([0], [1], {(0, 1): twentieths / 20})] * 3)
    assert scored.hota == scored.detection == scored.association == pytest.approx(min(twentieths, 19) / 19)


@pytest.mark.parametrize(("similar", "matched"), [(0.5, True), (np.nextafter(0.5, 0.0), False)])
def test_a_half_is_similar_enough_to_be_the_same(similar: float, matched: bool) -> None:
    frames = [frame([0], [k], {(0, k): similar}) for k in (1, 2)]
    assert identity_switches(frames) == int(matched)
    assert idf1(frames) == (0.5 if matched else 0.0)


def test_a_found_person_too_many_lowers_detection() -> None:
    frames = [frame([0], [1, 2], {(0, 1): 1.0})] * 4
    assert hota(frames).detection == 0.5
    assert idf1(frames) == pytest.approx(2 * 4 / 12)


def test_nobody_there_and_nobody_found_is_perfect_and_nobody_found_is_nothing() -> None:
    assert hota([frame([], [], {})]).hota == idf1([frame([], [], {})]) == 1.0
    assert hota([frame([0], [], {})]).hota == idf1([frame([0], [], {})]) == 0.0


def test_similarity_falls_with_the_mean_distance_of_the_joints_that_both_have() -> None:
    true = np.zeros((1, 4, 3))
    found = np.stack([np.full((4, 3), x) * [1, 0, 0] for x in (0.0, 0.25, 1.5)])
    found[1, 0] = np.nan
    np.testing.assert_allclose(similarity(true, found), [[1.0, 0.75, 0.0]])
    assert similarity(true, np.full((1, 4, 3), np.nan)) == 0
    assert similarity(true, np.zeros((0, 4, 3))).shape == (1, 0)
    np.testing.assert_allclose(similarity(true, found, zero_at=2.0), [[1.0, 0.875, 0.25]])


def defined_hota(frames: list[IdentityFrame], alpha: float) -> float:
    """HOTA at one α, term by term as in section 5 of the paper, of all ways to match found to true people."""
    pairs = [
        {(t, f): s for t, row in zip(one.true_ids, one.similarity, strict=True)
         for f, s in zip(one.found_ids, row, strict=True)} for one in frames
    ]  # fmt: skip
    trues, founds = Counter(t for f in frames for t in f.true_ids), Counter(i for f in frames for i in f.found_ids)
    loose: Counter[tuple[int, int]] = Counter()
    for likeness in pairs:
        for (t, f), s in likeness.items():
            with_either = sum(other for (a, b), other in likeness.items() if a == t or b == f)
            loose[t, f] += s / with_either if with_either else 0  # type: ignore[assignment]
    aligned = {pair: both / (trues[pair[0]] + founds[pair[1]] - both) for pair, both in loose.items()}
    hits: Counter[tuple[int, int]] = Counter()
    for one, likeness in zip(frames, pairs, strict=True):
        many, few = sorted((one.true_ids, one.found_ids), key=len, reverse=True)
        ways = [
            [(t, f) if many is one.true_ids else (f, t) for t, f in zip(chosen, few, strict=True)]
            for chosen in permutations(many, len(few))
        ]
        best = max(ways, key=lambda way: sum(aligned[pair] * likeness[pair] for pair in way))
        hits.update(pair for pair in best if likeness[pair] >= alpha)
    total = sum(hits.values())
    together = sum(n * n / (trues[t] + founds[f] - n) for (t, f), n in hits.items())
    return float(np.sqrt(together / (sum(trues.values()) + sum(founds.values()) - total)))


@pytest.mark.parametrize("seed", range(12))
def test_hota_is_what_its_authors_define(seed: int) -> None:
    """Of people who resemble several others, so that the match depends on who was there together for how long."""
    random = np.random.default_rng(seed)
    frames = []
    for _ in range(10):
        true, found = (np.flatnonzero(random.random(3) < 0.8) for _ in range(2))
        s = random.uniform(0.2, 1.0, (len(true), len(found))) * np.where(true[:, None] == found, 1.0, 0.8)
        frames.append(IdentityFrame(tuple(true.tolist()), tuple(found.tolist()), s))
    for alpha in (0.05, 0.5, 0.7):
        assert hota(frames, [alpha]).hota == pytest.approx(defined_hota(frames, alpha))


def test_who_was_never_matched_is_matched_with_the_most_similar() -> None:
    first = frame([0], [1, 2], {(0, 1): 0.6, (0, 2): 0.9})
    assert identity_switches([first, frame([0], [2], {(0, 2): 0.9})]) == 0
    assert identity_switches([first, frame([0], [1], {(0, 1): 0.9})]) == 1
