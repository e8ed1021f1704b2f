"""The figures of a line of the paper's tables from stored episodes, and how they are printed beside the paper's.

AP is pooled over all frames of all scenes, as is usual; 95 % intervals are over scenes: Gaffke's for AP and shares (for
a share of runs under one attack that is the exact binomial one), Student's t for frames, cut at 0, and Student's t over
jackknife values for the share of lost AP regained.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cp_env import evaluation
from cp_env.evaluation.analysis.comparisons import paired_difference
from cp_env.evaluation.plan.records import PooledApMeter
from cp_env.metrics.average_precision import resampled_ap
from cp_env.metrics.identification import id_rate, mc_rate, recovery
from cp_env.metrics.intervals import Interval, jackknife_interval
from cp_env.metrics.shares import share_interval
from cp_env.settings import Fusion
from examples.reproduce.paper_tables import HEADLINE, NAMES, TABLE_3, Line, PaperTable

TITLES = {
    "ap50": "AP@0.5 in %",
    "ap70": "AP@0.7 in %",
    "id_rate": "attackers identified, %",
    "mc_rate": "benign misclassified, % of the benign",
    "mc_runs": "runs with a benign vehicle misclassified, %",
    "frames_to_convergence": "frames to convergence",
}
EGO = 0

Figures = dict[str, Interval | None]  # by name
Found = dict[tuple[str, str], Figures]  # by fusion and label
Records = Mapping[evaluation.Run, Sequence[evaluation.Record]]
ByFusion = Mapping[Fusion, Records]


def figures(line: Line, results: Records) -> Figures:
    """AP averaged over the line's attacks; the other figures over the episodes of all of them."""
    groups = [_records(results, line.defender, attack) for attack in line.attacks]
    as_one: dict[evaluation.Run, list[evaluation.Record]] = {}
    for run, of in results.items():
        if run.defender == line.defender and run.attack in line.attacks:
            as_one.setdefault(replace(run, attack="all"), []).extend(of)
    (row,) = evaluation.summarise(as_one, resamples=1)  # its own AP is not used
    ap = {"ap50": evaluation.mean_ap(groups, 0.5), "ap70": evaluation.mean_ap(groups, 0.7)}
    others = {name: getattr(row, name) for name in TITLES if hasattr(row, name) and name not in ap}
    return {**ap, **others, "mc_runs": misclassified_runs([record for group in groups for record in group])}


def misclassified_runs(records: Sequence[evaluation.Record]) -> Interval:
    """Share of the runs in which a benign vehicle is flagged; over scenes, as a scene's runs share its traffic."""
    scenes: dict[str, list[float]] = {}
    for record in records:
        misclassified = mc_rate(record.suspects, record.attackers, record.n_maps) > 0
        scenes.setdefault(record.scene, []).append(float(misclassified))
    return share_interval([float(np.mean(runs)) for runs in scenes.values()])


def regained(results: Records, defender: str, attack: str) -> Interval:
    """Share of the AP lost to the attack that the defender regains: the mean of that at AP@0.5 and AP@0.7."""
    ours, attacked, best = (
        [PooledApMeter.pool([record.meter]) for record in _records(results, name, played)]
        for name, played in ((defender, attack), ("none", attack), ("none", "none"))
    )
    aps = [[resampled_ap(pool, iou) for pool in (ours, attacked, best)] for iou in (0.5, 0.7)]
    return jackknife_interval(
        lambda rows: float(np.mean([recovery(*(ap(rows) for ap in of)) for of in aps])), len(ours)
    )


def shown(figure: str, interval: Interval | None) -> tuple[float, float, float] | None:
    """Mean and bounds in the unit of the title."""
    if interval is None:
        return None
    scale = 1.0 if figure == "frames_to_convergence" else 100.0
    return scale * interval.mean, scale * interval.low, scale * interval.high


def cell(figure: str, interval: Interval | None, theirs: float | None = None) -> str:
    """Ours [95 % interval], and the paper's behind a stroke if it has one."""
    ours = shown(figure, interval)
    text = "–" if ours is None else "{:.1f} [{:.1f}, {:.1f}]".format(*ours)
    return text if theirs is None else f"{text} \\| {theirs:.1f}"


def markdown(found: Found, table: PaperTable, fusions: Sequence[Fusion]) -> Iterator[str]:
    """A table a figure."""
    for figure in table.figures:
        yield head(TITLES[figure], fusions)
        for line in table.lines:
            cells = [
                cell(figure, found[fusion, line.label][figure], _published(table, line, figure, fusion))
                for fusion in fusions
            ]
            yield f"| {line.label} | " + " | ".join(cells) + " |"


def headline(results: ByFusion, defender: str = "prbi") -> Iterator[str]:
    """The share of lost AP that a defender regains, by fusion, beside what the paper's Table 3 gives."""
    yield head("share of the lost AP regained, %", list(results))
    for attack, published in HEADLINE.items():
        cells = [
            cell(
                "ap50",
                regained(of, defender, attack),
                published if fusion == "v2vnet" else papers_share(attack, fusion),
            )
            for fusion, of in results.items()
        ]
        yield f"| {NAMES[attack]}, {defender} | " + " | ".join(cells) + " |"


def fig_6(results: ByFusion) -> Iterator[str]:
    """Similarity of consecutive outputs of an undefended ego, and of the first attacked one to the benign one before.

    The paper's Fig. 6 (Sec. 8) has no numbers: "around 0.8" without an attack, and with one "often well below 0.3, and
    peaking only around 0.2".
    """
    yield head("similarity of consecutive outputs", [*results, "paper"])
    for attack, theirs in (("none", "around 0.8"), *((a, "below 0.3") for a in NAMES)):
        cells = [f"{_similarity(of, attack, both=True):.2f}" for of in results.values()]
        yield f"| {NAMES.get(attack, 'upper bound')} | " + " | ".join(cells) + f" | {theirs} |"
    for attack in NAMES:
        cells = [f"{_similarity(of, attack, both=False):.2f}" for of in results.values()]
        yield f"| {NAMES[attack]}, to the benign frame before | " + " | ".join(cells) + " | |"


def _similarity(results: Records, attack: str, *, both: bool) -> Interval:
    """Over scenes: of frames whose predecessor was attacked as well, or of the first attacked frame."""
    frames = [r.similarity[r.grace_frames :] for r in _records(results, "none", attack)]
    chosen = [values[1:] or values if both else values[:1] for values in frames]
    return share_interval([float(np.mean(values)) for values in chosen])


def by_ego(results: ByFusion, lines: Sequence[Line]) -> Iterator[str]:
    """AP@0.5 of the lines under attack where the ego is benign, and where it is an attacker itself."""
    for title, malicious in (("the ego is benign", False), ("the ego is an attacker", True)):
        parts = {fusion: _where(of, malicious) for fusion, of in results.items()}
        scenes = {record.scene for part in parts.values() for records in part.values() for record in records}
        if not scenes:
            continue
        yield head(f"AP@0.5 in %, {title}: {len(scenes)} scenes", list(parts))
        for line in lines:
            aps = [
                evaluation.mean_ap([_records(part, line.defender, a) for a in line.attacks], 0.5)
                for part in parts.values()
            ]
            yield f"| {line.label} | " + " | ".join(cell("ap50", ap) for ap in aps) + " |"


def objectives(results: Records, defenders: Sequence[str] = ("none", "prbi")) -> Iterator[str]:
    """What the standard detection loss does to a defender beside our objective: by frame, and paired by scene.

    The similarity is that of what all vehicles together see to what the ego saw last, over the attacked frames.
    """
    columns = (
        "standard loss",
        "standard − ours, paired",
        "similarity: ours, standard",
        "identified, %: ours, standard",
    )
    yield head("detection loss/frame", ("our objective", *columns))
    for defender in defenders:
        for attack, name in NAMES.items():
            ours, standard = (
                _records(results, defender, attack + option) for option in ("", ":objective=detection_loss")
            )
            damages = [[float(np.mean(record.damage)) for record in of] for of in (ours, standard)]
            more, _ = paired_difference(damages[1], damages[0])
            cells = [f"{share_interval(of):.3f}" for of in damages] + [f"{more:+.3f}"]
            for measure, digits in ((_to_the_last, 2), (_identified, 0)):
                cells.append(", ".join(f"{np.mean([measure(r) for r in of]):.{digits}f}" for of in (ours, standard)))
            yield f"| {name}, {defender} | " + " | ".join(cells) + " |"


def _to_the_last(record: evaluation.Record) -> float:
    return float(np.mean(record.similarity[record.grace_frames :]))


def _identified(record: evaluation.Record) -> float:
    return 100 * id_rate(record.suspects, record.attackers)


def head(title: str, columns: Sequence[str]) -> str:
    return f"\n| {title} | " + " | ".join(columns) + " |\n|---|" + "---|" * len(columns)


def _records(results: Records, defender: str, attack: str) -> list[evaluation.Record]:
    """The episodes of one defender against one attack, by scene."""
    played = [r for run, of in results.items() if (run.defender, run.attack) == (defender, attack) for r in of]
    return sorted(played, key=lambda record: record.scene)


def _where(results: Records, malicious: bool) -> Records:
    """The attacked episodes in which the ego is an attacker, or is not."""
    part = {run: [r for r in of if r.attackers and (EGO in r.attackers) == malicious] for run, of in results.items()}
    return {run: records for run, records in part.items() if records}


def papers_share(attack: str, fusion: Fusion) -> float:
    """What the paper's Table 3 gives for the headline, in per cent."""
    lines, place = {line.label: line.paper for line in TABLE_3.lines}, TABLE_3.fusions.index(fusion)
    rows = [lines[label] for label in (f"{NAMES[attack]}, PRBI", f"{NAMES[attack]}, no defence", "upper bound")]
    return 100 * float(np.mean([recovery(*(row[figure][place] for row in rows)) for figure in ("ap50", "ap70")]))


def _published(table: PaperTable, line: Line, figure: str, fusion: Fusion) -> float | None:
    """The paper's figure of a line, if it has one."""
    return line.paper[figure][table.fusions.index(fusion)] if figure in line.paper else None
