"""Attacks on the defence itself, under a verifier that sees every lie: lies timed, hidden and placed to hurt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from defenders import Bayes, Prbi
from defenders.perfect import Episode, Terms, every
from defenders.tally import Tally, play_many
from examples.reproduce import prbi_attacks
from examples.reproduce.prbi_attacks import FIVE, SITUATIONS

EPISODES = 12


def robust() -> Prbi:
    return Prbi(stopping="robust", rearm=True)


def played(defender: Prbi, terms: Terms, episodes: int = EPISODES) -> Tally:
    return play_many(defender, terms, episodes=episodes, seed=0)


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS) - {"framing", "nobody"}))
def test_robust_and_rearmed_withstands(situation: str) -> None:
    tally = played(robust(), SITUATIONS[situation])
    assert tally.converged.all() and tally.solved.all()
    assert not tally.deceived[:, -10:].any()


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS) - {"framing", "nobody", "out of step"}))
def test_bayes_withstands(situation: str) -> None:
    """Not liars out of step, since it takes all liars to be at work or none."""
    tally = played(Bayes(likelihood="perfect"), SITUATIONS[situation], 2)
    assert tally.solved.all() and not tally.deceived[:, -10:].any()
    assert tally.all_verifications.max() <= 2


@pytest.mark.parametrize("stopping", ["paper", "robust"])
@pytest.mark.parametrize("period", [3, 5])
def test_lying_seldom_buys_nothing(period: int, stopping: str) -> None:
    """Table 6: nothing is verified or counted in a normal frame, so the abnormal ones go as if they came in a row."""

    def abnormal(terms: Terms) -> list[object]:
        episode: Episode = terms.play(Prbi(stopping=stopping), 3)
        return [(r.verdict, r.verifications) for r in episode.rulings if r.lying]

    steady = abnormal(replace(FIVE, max_frames=8))
    seldom = abnormal(replace(FIVE, max_frames=8 * period, schedule=every(period, start=1)))
    assert seldom == steady


@pytest.mark.parametrize("k", [1, 2, 3, 4])
@pytest.mark.parametrize("period", [1, 3, 5])
def test_liars_on_a_schedule_are_all_found(period: int, k: int) -> None:
    for stopping in ("paper", "robust"):
        terms = replace(FIVE, n_liars=k, schedule=every(period, start=1), max_frames=100, until_converged=True)
        tally = played(Prbi(stopping=stopping), terms, 4)
        assert tally.converged.all() and (tally.identified == 1).all()
        assert not tally.deceived.any()


def test_the_paper_trusts_the_first_frame() -> None:
    """A lie in it is a reference that nothing resembles: the published algorithm never recovers."""
    tally = played(Prbi(), SITUATIONS["first frame"], 10)
    assert not tally.converged.any()
    assert (tally.deceived > 0).all()


@pytest.mark.parametrize("k", [1, 2, 3])
def test_robust_recovers_from_a_poisoned_reference(k: int) -> None:
    """Two searches that find nobody; from the third frame on the reference is right, if two honest views agree."""
    tally = played(robust(), replace(SITUATIONS["first frame"], n_liars=k))
    assert tally.solved.all() and not tally.deceived[:, 2:].any()


def test_robust_recovers_even_if_all_but_one_lie_from_the_first_frame() -> None:
    """One honest view has nobody to agree with, so references are tried until one holds: at 1 in 5 a frame."""
    tally = played(robust(), replace(SITUATIONS["first frame"], n_liars=4, max_frames=100))
    assert tally.solved.all()


@pytest.mark.parametrize("stopping", ["paper", "robust"])
def test_a_turncoat_goes_unnoticed_without_rearm(stopping: str) -> None:
    tally = played(Prbi(stopping=stopping), SITUATIONS["turncoat"])
    assert tally.converged.all() and (tally.identified == 0.5).all()
    assert (tally.deceived[:, 19:] == 1).all() and not tally.verifications[:, 19:].any()


@pytest.mark.parametrize("k", [1, 2, 3, 4])
@pytest.mark.parametrize("stopping", ["paper", "robust"])
def test_a_turncoat_is_found_with_rearm(stopping: str, k: int) -> None:
    tally = played(Prbi(stopping=stopping, rearm=True), replace(SITUATIONS["turncoat"], n_liars=k), 6)
    assert tally.converged.all() and (tally.identified == 1).all()
    assert not tally.deceived.any(), "neither the turncoat nor who was convicted before is ever fused while lying"


def test_all_but_one_lie() -> None:
    for n in (2, 6, 12):
        tally = played(Prbi(stopping="robust"), Terms(n_vehicles=n, n_liars=n - 1), 6)
        assert tally.solved.all() and tally.frames.max() <= n
        assert tally.verifications.max() <= 2 * (n - 1)


@pytest.mark.parametrize("knobs", [{}, {"stopping": "robust", "rearm": True}])
def test_nobody_lies_for_a_thousand_frames(knobs: dict[str, object]) -> None:
    tally = played(Prbi(**knobs), SITUATIONS["nobody"], 1)  # type: ignore[arg-type]
    assert tally.frames.tolist() == [1000]
    assert not tally.accused.any() and not tally.all_verifications.any()
    assert (tally.fused == 0b11111).all()


def test_framing_is_contained() -> None:
    """Who of the pair lies cannot be known. The published rule goes on fusing both; ours hardly ever does."""
    terms = SITUATIONS["framing"]
    paper, ours = (prbi_attacks.fooled(played(d, terms), terms).sum(axis=1).mean() for d in (Prbi(), robust()))
    assert paper > 20 and ours < 2


def test_liars_out_of_step_fool_the_published_rule() -> None:
    """Who is honest while another lies passes, and is never suspected again, as its probability is above zero."""
    tally = played(Prbi(), SITUATIONS["out of step"])
    assert tally.solved.mean() < 0.5 and (tally.deceived > 0).any()


def test_the_rows() -> None:
    row = prbi_attacks.measure(Prbi(stopping="robust"), SITUATIONS["all but one"], 5, 0)
    assert (row.sure, row.right, row.ID, row.MC, row.fooled) == (1, 1, 1, 0, 0)
    assert row.most <= 8 and np.isfinite(row.looks)
    nobody = prbi_attacks.measure(Prbi(), SITUATIONS["nobody"], 1, 0)
    assert nobody.ID is None and nobody.looks == 0
