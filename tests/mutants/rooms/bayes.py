"""Mistakes in the Bayesian defender: its densities, its posterior, its choice of groups."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FOLDER = "defenders/bayes/"
TESTS = "tests/defenders/bayes/"
POSTERIOR = (f"{TESTS}test_posterior.py",)
LIKELIHOOD = (f"{TESTS}test_likelihood.py",)
HISTOGRAMS = (f"{TESTS}test_histograms.py",)
ACQUISITION = (f"{TESTS}test_acquisition.py",)
PARTICLES = (f"{TESTS}test_particles.py",)
DEFENDER = (f"{TESTS}test_defender.py",)
INFORMATION = (f"{TESTS}test_information.py",)
SMALL_FLEET = (f"{TESTS}test_small_fleet.py",)
FLEET = (f"{TESTS}test_fleet.py",)
ACQUISITION_EDGES = (f"{TESTS}test_acquisition_edges.py",)
HISTOGRAMS_EDGES = (f"{TESTS}test_histograms_edges.py",)
LIKELIHOOD_EDGES = (f"{TESTS}test_likelihood_edges.py",)
PARTICLES_EDGES = (f"{TESTS}test_particles_edges.py",)
POSTERIOR_EDGES = (f"{TESTS}test_posterior_edges.py",)
DEFENDER_EDGES = (f"{TESTS}test_defender_edges.py",)

MUTANTS = (
    Mutant(
        "a-prior-over-numbers-alone",
        f"{FOLDER}posterior.py",
        "1 / (max(n, 1) * comb(n, k))",
        "1 / max(n, 1)",
        POSTERIOR,
    ),
    Mutant(
        "attackers-are-born-anew-only",
        f"{FOLDER}posterior.py",
        "joint[:, 0, 1:] += switch_prob",
        "joint[:, 0, 1:] = switch_prob",
        POSTERIOR,
    ),
    Mutant(
        "sets-change-in-pauses-too",
        f"{FOLDER}posterior.py",
        "joint[:, :, 1:] *= 1 - switch_prob",
        "joint *= 1 - switch_prob",
        POSTERIOR,
    ),
    Mutant(
        "outliers-of-those-who-attack",
        f"{FOLDER}posterior.py",
        "joint[~sets.any(1), :, 1:] *=",
        "joint[sets.any(1), :, 1:] *=",
        POSTERIOR,
    ),
    Mutant(
        "references-renewed-the-wrong-way",
        f"{FOLDER}posterior.py",
        "joint.sum(1 if renew else 2)",
        "joint.sum(2 if renew else 1)",
        POSTERIOR,
    ),
    Mutant(
        "all-members-are-shared",
        f"{FOLDER}posterior.py",
        "(self.group & self.reference).sum()",
        "(self.group | self.reference).sum()",
        POSTERIOR,
    ),
    Mutant(
        "absent-attackers-in-the-full-view",
        f"{FOLDER}posterior.py",
        "sets[:, self.present].sum(1), -1)",
        "sets.sum(1), -1)",
        POSTERIOR_EDGES,
    ),
    Mutant(
        "an-outlier-is-an-attack",
        f"{FOLDER}posterior.py",
        "self.mass[self.sets.any(1), :, 1:].sum((0, 1))",
        "self.mass[:, :, 1:].sum((0, 1))",
        POSTERIOR_EDGES,
    ),
    Mutant(
        "contaminated-in-the-other-frame",
        f"{FOLDER}posterior.py",
        "self.mass.sum(1 if now else 2)",
        "self.mass.sum(2 if now else 1)",
        POSTERIOR_EDGES,
    ),
    Mutant("a-bin-without-its-lower-edge", f"{FOLDER}likelihood.py", 'side="right"', 'side="left"', HISTOGRAMS),
    Mutant(
        "the-mode-of-the-wrong-view",
        f"{FOLDER}likelihood.py",
        "rows[:, :, 1:, 1:-1] = self._one_contaminated[1:, reference, 1 : reference + 1, one]",
        "rows[1:, :, :, 1:-1] = self._one_contaminated[1:, reference, None, None, 1 : reference + 1, one]",
        LIKELIHOOD,
    ),
    Mutant(
        "an-outlier-of-groups-that-do-not-fit",
        f"{FOLDER}likelihood.py",
        "shared = range(max(size + other - self.most, 0), min(size, other) + 1)",
        "shared = range(min(size, other) + 1)",
        LIKELIHOOD_EDGES,
    ),
    Mutant("entropy-in-nats", f"{FOLDER}likelihood.py", "p * np.log2(", "p * np.log(", ACQUISITION),
    Mutant(
        "outliers-mixed-the-wrong-way",
        f"{FOLDER}likelihood.py",
        "(1 - OUTLIER_MIX) * rows[0] + OUTLIER_MIX * np.mean(",
        "OUTLIER_MIX * rows[0] + (1 - OUTLIER_MIX) * np.mean(",
        LIKELIHOOD,
    ),
    Mutant(
        "twice-the-total-variation",
        f"{FOLDER}likelihood.py",
        "np.abs(one - none).sum() / 2",
        "np.abs(one - none).sum()",
        HISTOGRAMS_EDGES,
    ),
    Mutant(
        "two-modes-resemble-as-the-higher",
        f"{FOLDER}histograms.py",
        "min(mode, other_mode) - 1",
        "max(mode, other_mode) - 1",
        HISTOGRAMS_EDGES,
    ),
    Mutant(
        "fades-while-it-is-measured",
        f"{FOLDER}histograms.py",
        "FADES ** max(age - self.oldest, 0)",
        "FADES ** max(age - 1, 0)",
        HISTOGRAMS_EDGES,
    ),
    Mutant(
        "diluted-the-wrong-way",
        f"{FOLDER}histograms.py",
        "return diluted * self.one_contaminated(self.most, 1, other, mode) + (1 - diluted) * none",
        "return (1 - diluted) * self.one_contaminated(self.most, 1, other, mode) + diluted * none",
        HISTOGRAMS_EDGES,
    ),
    Mutant(
        "information-before-the-noise",
        f"{FOLDER}information.py",
        "return entropy(found.sum(1)) - rest @ hypotheses.weight",
        "return entropy(found.sum(1))",
        INFORMATION,
    ),
    Mutant(
        "seen-groups-are-chosen-again",
        f"{FOLDER}acquisition.py",
        "(groups[:, None] != seen).any(2).all(1)",
        "(groups[:, None] != seen).any(2).any(1)",
        ACQUISITION_EDGES,
    ),
    Mutant(
        "a-sample-that-weighs-its-counts",
        f"{FOLDER}information.py",
        "mass = (times / size)",
        "mass = (times * 1.0)",
        INFORMATION,
    ),
    Mutant(
        "utility-of-pauses-alone",
        f"{FOLDER}acquisition.py",
        "value = value + mass[active, mode] @",
        "value = value - mass[active, mode] @",
        ACQUISITION,
    ),
    Mutant(
        "exchanged-with-itself",
        f"{FOLDER}particles.py",
        "sets[rows, one] != sets[rows, two]",
        "sets[rows, one] == sets[rows, two]",
        PARTICLES_EDGES,
    ),
    Mutant(
        "every-move-uphill-is-refused",
        f"{FOLDER}particles.py",
        "* current.sum(1) < density.sum(1)",
        "* density.sum(1) < current.sum(1)",
        PARTICLES,
    ),
    Mutant(
        "a-replay-without-its-scale",
        f"{FOLDER}particles.py",
        "self.frame.total *= total",
        "self.frame.total = total",
        PARTICLES,
    ),
    Mutant(
        "the-output-is-paid",
        f"{FOLDER}defender.py",
        "yield Query([collaborators], verification=False)",
        "yield Query([collaborators], verification=True)",
        DEFENDER,
    ),
    Mutant(
        "verifies-while-sure",
        f"{FOLDER}defender.py",
        "self.posterior.attack_probs().sum() < ALARM_PROB",
        "self.posterior.attack_probs().sum() < 0",
        DEFENDER,
    ),
    Mutant(
        "kinds-of-smaller-groups",
        f"{FOLDER}small_fleet.py",
        "self.table.density[self.row[group.sum() - 1], found]",
        "self.table.density[self.row[group.sum() - 2], found]",
        SMALL_FLEET,
    ),
    Mutant(
        "the-full-view-without-its-noise",
        f"{FOLDER}small_fleet.py",
        "rest = rest + self.full_view.table.entropy[self.other]",
        "rest = rest * 1.0",
        SMALL_FLEET,
    ),
    Mutant(
        "the-fleet-of-other-densities",
        f"{FOLDER}histograms.py",
        "isinstance(other, Calibrated) and self._digest == other._digest",
        "isinstance(other, Calibrated) and self.most == other.most",
        FLEET,
    ),
    Mutant("references-that-do-not-age", f"{FOLDER}defender.py", "self.age += 1", "self.age = 1", DEFENDER_EDGES),
)
