"""The arena's plots, as SVG. A colour is one defender and a marker one attack, in all of them.

No window, no global state of matplotlib, no date in the file: the same values give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cp_env.evaluation.analysis.curves import AXES, Curve
from cp_env.evaluation.analysis.summary import Row
from cp_env.evaluation.analysis.worst_case import Ranking
from cp_env.evaluation.plan.runs import NO_ATTACK
from cp_env.metrics.intervals import Interval
from cp_env.rendering import style

WIDTH = 9.2
"""Inches; on a page of 690 pixels, text of 10 points is 10 pixels high."""
MARKERS = "osD^vP*X<>pHd84hx+123"
STYLE: dict[Any, Any] = {
    **style.parameters(),
    "text.parse_math": False,  # names are shown as they are
    "svg.hashsalt": "cp_env",
    "font.size": 10,
    "axes.labelsize": 10,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
}
Colours = Mapping[str, tuple[float, float, float]]


def trade_off(rows: Sequence[Row], colours: Colours) -> str:
    """What a defence keeps (AP) against what it loses (damage) and what it costs (verifications): means."""
    attacks = list(dict.fromkeys(row.attack for row in rows))
    markers = {attack: MARKERS[i % len(MARKERS)] for i, attack in enumerate(attacks)}
    with matplotlib.rc_context(STYLE):
        figure = _figure(WIDTH, 5.4)
        left, right = figure.subplots(1, 2, sharey=True)
        for row in rows:
            for axis, x in ((left, row.damage), (right, row.verifications)):
                line = {"color": colours[row.defender], "marker": markers[row.attack], "ms": 7, "alpha": 0.8}
                axis.plot(x.mean, row.ap50.mean, ls="none", **line)
        left.set(ylim=(-0.02, 1.02), xlabel="detection loss (1 − Jaccard)/frame", ylabel="AP@0.5")
        right.set(xlabel="verifications/frame")
        for name, colour in colours.items():
            left.plot([], [], "o", color=colour, label=name)
        for attack, marker in markers.items():
            right.plot([], [], marker, color=style.GREY, label="no attack" if attack == NO_ATTACK else attack)
        _legend_below(figure, left, "defenders", "outside lower left")
        _legend_below(figure, right, "attacks", "outside lower right")
        return _svg(figure)


def bars(rankings: Sequence[Ranking], colours: Colours | None, xlabel: str) -> str:
    """Worst cases with their intervals, best on top: damage on the left, AP@0.5 on the right."""
    names = [ranking.entry for ranking in rankings]
    shades = [style.GREY if colours is None else colours[name] for name in names]
    with matplotlib.rc_context(STYLE):
        figure = _figure(WIDTH, 1.2 + 0.32 * len(names))
        axes = figure.subplots(1, 2, sharey=True)
        for axis, values, label in (
            (axes[0], [s.damage for s in rankings], f"detection loss/frame, {xlabel}"),
            (axes[1], [s.ap50 for s in rankings], f"AP@0.5 of a scene, {xlabel}"),
        ):
            axis.barh(names, [f.mean for f in values], xerr=_reach(values), color=shades, capsize=3, height=0.7)
            axis.set(xlim=(0, 1), xlabel=label)
            axis.grid(axis="y", visible=False)
        axes[0].invert_yaxis()
        return _svg(figure)


def lines(curve: Curve, colours: Colours) -> str:
    """Worst cases over an axis: damage on the left, AP@0.5 on the right; one line a defender, dodged."""
    with matplotlib.rc_context(STYLE):
        figure = _figure(WIDTH, 4.6)
        axes = figure.subplots(1, 2)
        named = isinstance(curve.values[0], str)
        x = np.arange(len(curve.values)) if named else np.array(curve.values, dtype=float)
        step = float(np.diff(x).min()) if len(x) > 1 else 1.0
        for axis, values, label in ((axes[0], curve.damage, "detection loss/frame"), (axes[1], curve.ap50, "AP@0.5")):
            for number, (name, intervals) in enumerate(values.items()):
                dodge = (number - (len(values) - 1) / 2) * 0.035 * step
                axis.errorbar(
                    x + dodge,
                    [f.mean for f in intervals],
                    _reach(intervals),
                    color=colours[name],
                    marker="o",
                    ls="none" if named else "-",
                    ms=4,
                    capsize=2,
                    elinewidth=0.8,
                    label=name,
                )
            axis.set(ylim=(-0.02, 1.02), xlabel=AXES[curve.axis], ylabel=label)
            axis.set_xticks(x, [str(value) for value in curve.values])
        figure.suptitle("\n".join(wrap(curve.under, 110)), fontsize="small")
        _legend_below(figure, axes[0], "defenders", "outside lower center")
        return _svg(figure)


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _legend_below(figure: Figure, axis: Axes, title: str, where: Any) -> None:
    handles, labels = axis.get_legend_handles_labels()
    columns = 3 if "center" in where else 1 if max(map(len, labels), default=0) > 20 else 2
    figure.legend(handles, labels, title=title, loc=where, ncols=columns, fontsize="small", alignment="left")


def _reach(values: Sequence[Interval]) -> np.ndarray:
    """How far the intervals reach below and above their means."""
    return np.array([[f.mean - f.low for f in values], [f.high - f.mean for f in values]]).clip(0)


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
