"""Mistakes in the referee: what is counted, what is free, what is refused."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FILE = "cp_env/world/verification.py"
CHECKS = "defenders/checks.py"
TESTS = ("tests/cp_env/world/test_verification.py",)
TESTS_EDGES = ("tests/cp_env/world/test_verification_edges.py",)

MUTANTS = (
    Mutant(
        "a-repeated-group-counts-once",
        FILE,
        "len(self.groups) - len(self.uncounted)",
        "len(set(self.groups) - set(self.uncounted))",
        TESTS,
    ),
    Mutant(
        "a-free-query-counts",
        FILE,
        "self.uncounted += () if request.verification else request.groups",
        "self.uncounted += ()",
        TESTS,
    ),
    Mutant(
        "one-query-less-than-allowed",
        FILE,
        "self.queries > self.defender.max_queries",
        "self.queries >= self.defender.max_queries",
        TESTS_EDGES,
    ),
    Mutant(
        "a-group-of-absent-vehicles",
        FILE,
        "if not group & self.present or not group <= self.everyone:",
        "if not group or not group <= self.everyone:",
        TESTS_EDGES,
    ),
    Mutant(
        "an-absent-member-is-refused",
        FILE,
        "not group <= self.everyone",
        "not group <= self.present",
        TESTS_EDGES,
    ),
    Mutant(
        "a-verdict-of-absent-vehicles",
        FILE,
        "elif not verdict.collaborators & self.present",
        "elif not verdict.collaborators",
        TESTS_EDGES,
    ),
    Mutant(
        "suspects-that-do-not-exist",
        FILE,
        "return verdict.collaborators | verdict.suspects",
        "return verdict.collaborators",
        TESTS,
    ),
    Mutant("everything-asked-is-paid", FILE, "Counter(self.groups) - Counter(self.uncounted)", "self.groups", TESTS),
    Mutant(
        "a-query-that-changes-its-mind",
        FILE,
        "request = Query(request.groups, bool(request.verification))",
        "request = request",
        TESTS_EDGES,
    ),
    Mutant("a-view-computed-twice", FILE, " if group not in case.views}", "}", TESTS),
    Mutant(
        "a-memo-of-one-order",
        FILE,
        "(one, other) if one < other else (other, one)",
        "(one, other)",
        TESTS,
    ),
    Mutant(
        "answers-that-are-the-referees-own",
        FILE,
        "else self.views[group].twin()",
        "else self.views[group]",
        ("tests/cp_env/world/test_handed_out.py",),
    ),
    Mutant(
        "belief-of-the-last-vehicles", FILE, "padded[: len(belief)]", "padded[n_vehicles - len(belief) :]", TESTS_EDGES
    ),
    Mutant("two-references-are-free", CHECKS, "len(singles) > 1", "len(singles) > 2", TESTS),
    Mutant("paid-later-is-not-paid", CHECKS, " - set(counted)", "", TESTS),
    Mutant("groups-are-free", CHECKS, " or unpaid != singles", "", TESTS),
    Mutant("the-view-of-everyone-is-not-free", CHECKS, "{output, everyone}", "{output}", TESTS),
)
