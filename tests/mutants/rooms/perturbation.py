"""Mistakes in the channel, the balls, the objective and the transmission of perturbations."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FOLDER = "cp_env/perturbation/"
TESTS = "tests/cp_env/perturbation/"
CHANNEL = (f"{TESTS}test_channel.py",)
BALL = (f"{TESTS}test_ball.py",)
OBJECTIVE = (f"{TESTS}test_objective.py",)
TRANSMISSION = (
    "tests/cp_env/world/test_transmission.py",
    "tests/cp_env/world/test_absence.py",
)
FORMULA = ("tests/cp_env/world/test_world.py::test_step_agrees_with_the_formula_written_out",)
ASCENT = "cp_env/envs/actions/ascent.py"
CLIMBS = ("tests/cp_env/envs/actions/test_ascent.py",)
BALL_EDGES = (f"{TESTS}test_ball_edges.py",)
CHANNEL_EDGES = (f"{TESTS}test_channel_edges.py",)
TRANSMISSION_EDGES = ("tests/cp_env/world/test_transmission_edges.py",)

MUTANTS = (
    Mutant(
        "linf-norm-of-positive-entries",
        f"{FOLDER}channel.py",
        "torch.maximum(flat.amin(-1).abs(), flat.amax(-1).abs())",
        "flat.amax(-1).abs()",
        CHANNEL,
    ),
    Mutant(
        "l2-norm-without-root",
        f"{FOLDER}channel.py",
        "flat.double().norm(dim=-1)",
        "flat.double().square().sum(dim=-1)",
        CHANNEL,
    ),
    Mutant(
        "linf-clipped-on-one-side",
        f"{FOLDER}channel.py",
        "torch.clamp(delta, -budget, budget, out=out)",
        "torch.clamp(delta, max=budget, out=out)",
        CHANNEL,
    ),
    Mutant(
        "l2-stretched-to-the-surface",
        f"{FOLDER}channel.py",
        "(budget / length).clamp(max=1.0)",
        "(budget / length)",
        CHANNEL,
    ),
    Mutant(
        "inject-with-the-wrong-stride",
        f"{FOLDER}channel.py",
        "[:, None] * maps + attackers",
        "[:, None] * attackers.shape[1] + attackers",
        CHANNEL,
    ),
    Mutant(
        "projected-beside-the-given-place",
        f"{FOLDER}channel.py",
        "torch.clamp(delta, -budget, budget, out=out)",
        "torch.clamp(delta, -budget, budget)",
        BALL,
    ),
    Mutant("inject-in-place-of-the-map", f"{FOLDER}channel.py", ".index_add(0,", ".index_copy(0,", CHANNEL_EDGES),
    Mutant(
        "linf-start-in-one-orthant",
        f"{FOLDER}ball.py",
        ".mul_(2 * budget).sub_(budget)",
        ".mul_(budget)",
        BALL_EDGES,
    ),
    Mutant(
        "l2-start-on-the-surface",
        f"{FOLDER}ball.py",
        "self.project(self.steepest(direction) * length * budget, budget)",
        "self.project(direction * length * budget, budget)",
        BALL_EDGES,
    ),
    Mutant(
        "l2-steepest-over-the-batch",
        f"{FOLDER}ball.py",
        "torch.linalg.vector_norm(gradient, dim=MAP, keepdim=True)",
        "torch.linalg.vector_norm(gradient)",
        BALL,
    ),
    Mutant(
        "ascent-away-from-where-it-stands",
        f"{FOLDER}ball.py",
        "direction.mul_(length).add_(delta)",
        "direction.mul_(length).sub_(delta)",
        BALL_EDGES,
    ),
    Mutant(
        "hidden-objects-with-the-wrong-sign",
        f"{FOLDER}objective.py",
        "hidden = _capped(-dense.logits[view, row, column]) - shown",
        "hidden = _capped(dense.logits[view, row, column]) - shown",
        OBJECTIVE,
    ),
    Mutant(
        "divided-by-no-vehicles",
        f"{FOLDER}objective.py",
        "count = objects.sum((-2, -1)).clamp(min=1.0)",
        "count = objects.sum((-2, -1))",
        OBJECTIVE,
    ),
    Mutant("drift-summed", f"{FOLDER}objective.py", ".clamp(max=REACH).mean(1)", ".clamp(max=REACH).sum(1)", OBJECTIVE),
    Mutant("drift-without-reach", f"{FOLDER}objective.py", ".clamp(max=REACH).mean(1)", ".mean(1)", OBJECTIVE),
    Mutant(
        "blocks-that-overlap",
        f"{FOLDER}objective.py",
        "kernel_size=BLOCK, stride=BLOCK)",
        "kernel_size=BLOCK)",
        OBJECTIVE,
    ),
    Mutant(
        "ghosts-beside-objects",
        f"{FOLDER}objective.py",
        "highest_neighbour(objects) > 0",
        "objects > 0",
        OBJECTIVE,
    ),
    Mutant(
        "presence-of-the-first-vehicles",
        "cp_env/world/transmission.py",
        "situation.present.gather(1, attackers)",
        "situation.present[:, : attackers.shape[1]]",
        TRANSMISSION,
    ),
    Mutant(
        "inactive-worlds-send-with-active-ones",
        "cp_env/world/transmission.py",
        "situation.active[:, None] & situation.present",
        "situation.present",
        TRANSMISSION_EDGES,
    ),
    Mutant(
        "poses-of-the-first-vehicles",
        "cp_env/world/transmission.py",
        "situation.ego_T_sender[world, vehicle]",
        "situation.ego_T_sender[world, slot]",
        FORMULA,
    ),
    Mutant(
        "sent-without-the-projection",
        "cp_env/world/transmission.py",
        "rows, bounded,",
        "rows, mine,",
        FORMULA,
    ),
    Mutant(
        "norm-of-what-was-asked",
        "cp_env/world/transmission.py",
        "norm = channel.norm_of(mine, settings.norm)",
        "pass",
        TRANSMISSION,
    ),
    Mutant(
        "the-first-slot-sends-for-all",
        "cp_env/world/transmission.py",
        "world * k + slot",
        "world * k",
        FORMULA,
    ),
    Mutant(
        "rows-that-leave-the-map-come-in-on-the-other-side",
        "cp_env/detector/model/warp.py",
        "_clear_lost(one, shift[0])",
        "pass",
        ("tests/cp_env/world/test_received.py",),
    ),
    Mutant("faint-cells-too", ASCENT, "(felt > FAINT * felt.amax())", "(felt > 0)", CLIMBS),
    Mutant(
        "strongest-of-the-rising-alone",
        ASCENT,
        "torch.maximum(slope.amax(0, keepdim=True), slope.amin(0, keepdim=True).neg_())",
        "slope.amax(0, keepdim=True)",
        CLIMBS,
    ),
    Mutant("steps-of-lost-cells", ASCENT, "strongest[:, to] * share", "strongest[:, to]", CLIMBS),
    Mutant("slopes-of-the-first-world", ASCENT, "if b != last:", "if last < 0:", CLIMBS),
    Mutant("steps-without-a-ball", ASCENT, "-reach, reach, out=here)", "-9.0, 9.0, out=here)", CLIMBS),
    Mutant(
        "senders-of-the-next-world",
        "cp_env/detector/model/warp.py",
        "sending[e].nonzero()",
        "sending[e - 1].nonzero()",
        (f"{TESTS}test_output.py",),
    ),
)
