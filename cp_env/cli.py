"""The command `cp-env`: list and preview scenes, render an episode as a GIF, check rules, manage the cache."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from cp_env.settings import Action, Fusion, ObservationKind, Precision

if TYPE_CHECKING:
    from rich.table import Table

    from cp_env.world.cache_folder import StoredScene


def version() -> None:
    """Print the version of cp_env."""
    from cp_env import __version__

    print(__version__)


def scenes(source: str = "town/test", skip_broken: bool = False) -> None:
    """List the scenes of a source, with what moves and stands in them.

    Args:
        source: a name such as "town/train", or kind:path?option=value&option=value (docs/scenes.md).
        skip_broken: leave broken scenes out, and say which and why; of data sets on disk.
    """
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from cp_env.scenes import open_source

    opened = open_source(_named(source, skip_broken))
    table = Table(title=f"{opened.name}: {len(opened.names())} scenes", box=None, pad_edge=False)
    columns = ("scene", "kind", "frames", "radios", "vehicles", "parked", "walls", "RSU")
    for column in columns:
        table.add_column(column, justify="left" if column in columns[:2] else "right", no_wrap=True)
    for name in opened.names():
        scene = opened.load(name)
        place = scene.pose[:, ~np.isnan(scene.pose[..., 0]).all(axis=0), :2]  # of vehicles that are there at all
        path = np.nanmax(place, axis=0) - np.nanmin(place, axis=0)
        parked = int((np.hypot(*path.T) < 0.5).sum())
        numbers = (scene.n_connected, place.shape[1], parked, len(scene.obstacles))
        unit = "no" if scene.rsu is None else "yes"
        table.add_row(name, scene.kind, str(scene.n_frames), *map(str, numbers), unit)
    Console().print(table)


def scenes_export(
    source: str,
    out: Path,
    layout: str = "v2x-sim",
    names: tuple[str, ...] = (),
    frames: int | None = None,
    vehicles: int | None = None,
    skip_broken: bool = False,
) -> None:
    """Write the scenes of a source in the layout of a public data set, for other tools to read.

    Args:
        source: a name such as "town/test", or kind:path?option=value.
        out: a new folder.
        layout: "v2x-sim" (tables in the nuScenes format) or "opv2v".
        names: the scenes; all of them by default.
        frames: only the first so many of each scene.
        vehicles: only the first so many connected vehicles of each scene have a sensor.
        skip_broken: leave broken scenes out, and say which and why; of data sets on disk.
    """
    from rich.console import Console

    from cp_env.scenes import open_source
    from cp_env.scenes.export import export

    export(open_source(_named(source, skip_broken)), out, layout=layout, names=names, frames=frames, vehicles=vehicles)
    Console().print(f"{out}: written in the layout of {layout}", soft_wrap=True)


def scenes_preview(
    path: str,
    out: Path = Path("preview.gif"),
    scene: str | None = None,
    every: int = 5,
    frames: int | None = None,
    extent: float = 48.0,
    vehicles: int = 15,
    skip_broken: bool = False,
) -> None:
    """Render a scene of any source from above as a GIF, and print its vehicles and how often each is seen.

    Args:
        path: a data set's folder or file, or what names a source: "town/test", "opv2v:/data/OPV2V?split=test".
        out: where the GIF goes.
        scene: its name; the source's first by default.
        every: stride of the frames used.
        frames: use no more than the first so many.
        extent: m round the ego that the GIF shows.
        vehicles: how many vehicles, the nearest to the ego first, get a line of their own.
        skip_broken: leave broken scenes out, and say which and why; of data sets on disk.
    """
    from rich.console import Console

    from cp_env.scenes import open_source
    from cp_env.scenes.preview import film
    from cp_env.scenes.preview.tables import tables

    if every < 1:
        raise ValueError(f"every must be at least 1, got {every}")
    source = open_source(_named(film.spec_of(path), skip_broken))
    name = source.names()[0] if scene is None else scene
    loaded = source.load(name)
    chosen = list(range(0, min(loaded.n_frames, frames or loaded.n_frames), every))
    part = film.excerpt(source, name, chosen)
    for table in tables(film.figures(part), vehicles):
        Console().print(table)
    film.write_gif(film.film(part, extent=extent), out, seconds=every * loaded.dt)
    Console().print(f"{out}: {len(chosen)} frames of {name}", soft_wrap=True)


def _named(source: str, skip_broken: bool) -> str:
    """The source's name, with the option in it."""
    return f"{source}{'&' if '?' in source else '?'}skip_broken" if skip_broken else source


def play(
    defender: str = "prbi",
    out: Path = Path("episode.gif"),
    scenes: str = "town/test",
    action: Action = "guided",
    fusion: Fusion = "mean",
    detector: str = "cp_env",
    precision: Precision = "float32",
    n_vehicles: int = 5,
    n_attackers: int = 2,
    rsu: bool = False,
    max_frames: int = 50,
    seed: int = 0,
) -> None:
    """Play one episode of attackers with random actions, and render it as a GIF.

    Args:
        defender: the ego's defence, a name of `defenders.names()` with options if need be.
        out: where the GIF goes.
        scenes: a name such as "town/test", or kind:path?option=value&option=value (docs/scenes.md).
        action: "guided", "stealth", "critical", "basis" or "full".
        fusion: "mean", "max", "sum", "v2vnet" or "disconet".
        detector: "cp_env", "coperception:checkpoint=FILE", or "module:Class" of yours.
        precision: of the detector's maps, fusion and decoder: "float32", or the faster "bfloat16".
        n_vehicles: n, vehicles that share their maps.
        n_attackers: k, malicious vehicles among them.
        rsu: with the road-side unit's map as the last one; one vehicle is enough then.
        max_frames: frames of the episode, five a second.
        seed: of the episode and of the actions.
    """
    from rich.console import Console

    from cp_env import parallel_env
    from cp_env.progress import track
    from cp_env.rendering.gif import write_gif

    env = parallel_env(
        defender,
        scenes=scenes,
        action=action,
        fusion=fusion,
        detector=detector,
        precision=precision,
        n_vehicles=n_vehicles,
        n_attackers=n_attackers,
        rsu=rsu,
        max_frames=max_frames,
        render_mode="rgb_array",
    )
    env.reset(seed=seed)
    for number, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(seed + number)
    pictures, damage = [], 0.0
    for _ in track(range(max_frames), "playing", unit="frame"):
        *_, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        damage += infos[env.possible_agents[0]]["damage"]
        pictures.append(env.render())
        if not env.agents:
            break
    write_gif([picture for picture in pictures if picture is not None], out)
    Console().print(f"{out}: {len(pictures)} frames, mean damage {damage / len(pictures):.2f}", soft_wrap=True)


def check(
    defender: str = "prbi",
    action: Action = "guided",
    observation: ObservationKind = "features",
    fusion: Fusion = "mean",
    detector: str = "cp_env",
    precision: Precision = "float32",
    scenes: str = "town/test",
    rsu: bool = False,
    max_frames: int = 4,
    steps: int = 6,
    seed: int = 0,
) -> None:
    """Check an environment against every rule of `cp_env.testing`.

    Args:
        defender: the ego's defence, a name of `defenders.names()` with options if need be.
        action: "guided", "stealth", "critical", "basis" or "full".
        observation: "features" or "compact".
        fusion: "mean", "max", "sum", "v2vnet" or "disconet".
        detector: "cp_env", "coperception:checkpoint=FILE", or "module:Class" of yours.
        precision: of the detector's maps, fusion and decoder: "float32", or the faster "bfloat16".
        scenes: a name such as "town/test", or kind:path?option=value&option=value (docs/scenes.md).
        rsu: with the road-side unit's map as the last one; one vehicle is enough then.
        max_frames: frames of an episode.
        steps: calls a rule plays; more than an episode is better.
        seed: of the episodes and of the actions.
    """
    from rich.console import Console

    from cp_env import parallel_env
    from cp_env.testing import check_env

    rules = check_env(
        lambda: parallel_env(
            defender,
            action=action,
            observation=observation,
            fusion=fusion,
            detector=detector,
            precision=precision,
            scenes=scenes,
            rsu=rsu,
            max_frames=max_frames,
            render_mode="rgb_array",
        ),
        steps=steps,
        seed=seed,
    )
    Console().print(f"{len(rules)} rules kept: {', '.join(rules)}")


def cache(scenes: bool = False) -> None:
    """Show where encoded scenes are kept, how many, and how much they take.

    Args:
        scenes: one line a scene instead of one for each source and detector.
    """
    from rich.console import Console

    from cp_env.paths import cache_directory, cache_limit
    from cp_env.world import cache_folder

    folder, limit = cache_directory(), cache_limit()
    stored = cache_folder.stored_scenes(cache_folder.encoded_folder())
    Console().print(_cache_table(stored, scenes))
    indices, earlier = ([folder / name for name in cache_folder.INDICES], cache_folder.earlier_versions(folder))
    for what, places in (("indices of data sets", indices), ("maps of an earlier version, unused", earlier)):
        if held := sum(map(cache_folder.size, places)):
            Console().print(f"{what}: {held / 1e6:.1f} MB")
    bound = (
        "without a bound (CP_ENV_CACHE_SIZE)" if limit is None else f"bound {limit / 1e6:.0f} MB (CP_ENV_CACHE_SIZE)"
    )
    Console().print(f"{folder}: {sum(s.bytes for s in stored) / 1e6:.1f} MB of encoded scenes, {bound}", soft_wrap=True)


def _cache_table(stored: list[StoredScene], scenes: bool) -> Table:
    """A line for each source and detector, or for each scene."""
    from datetime import datetime
    from itertools import groupby

    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("source", "detector", "scene" if scenes else "scenes", "MB", "last used", "folder"):
        table.add_column(column, justify="right" if column in ("scenes", "MB") else "left")
    ordered = sorted(stored, key=lambda scene: (scene.key.name, scene.name if scenes else ""))
    for _, group in groupby(ordered, key=lambda scene: scene.folder if scenes else scene.key):
        found = list(group)
        used = datetime.fromtimestamp(max(scene.used for scene in found)).strftime("%Y-%m-%d %H:%M")
        what = found[0].name if scenes else str(len(found))
        size = f"{sum(scene.bytes for scene in found) / 1e6:.1f}"
        table.add_row(found[0].source, found[0].detector, what, size, used, found[0].key.name)
    return table


def cache_clear() -> None:
    """Delete encoded scenes, those of earlier versions, and indices of data sets. They are made again when needed."""
    from rich.console import Console

    from cp_env.paths import cache_directory
    from cp_env.world import cache_folder

    freed = cache_folder.clear(cache_directory())
    Console().print(f"{cache_directory()}: {freed / 1e6:.1f} MB deleted", soft_wrap=True)


def cache_bound(size: str) -> None:
    """Delete encoded scenes, those least recently used first, until the others take no more than a size.

    The environment variable CP_ENV_CACHE_SIZE holds the cache to a size all the time.

    Args:
        size: such as "20GB" or "500 MB".
    """
    from rich.console import Console

    from cp_env.paths import size_of
    from cp_env.world import cache_folder

    folder = cache_folder.encoded_folder()
    cache_folder.sweep(folder)
    left = cache_folder.bound(folder, size_of(size))
    Console().print(f"{folder}: {left / 1e6:.1f} MB of encoded scenes are left", soft_wrap=True)


SUMMARY = {
    "scenes": "list the scenes of a source",
    "scenes preview": "render a scene from above as a GIF, with tables of what is seen",
    "scenes export": "write scenes in the layout of a public data set",
    "evaluate": "accuracy of a detector without an attack, and its operating threshold",
    "play": "play one episode of random attackers, and render it as a GIF",
    "check": "check an environment against every rule",
    "cache": "show where encoded scenes are kept",
    "cache clear": "delete encoded scenes",
    "cache bound": "delete encoded scenes until the others fit a size",
    "version": "print the version; so does cp-env --version",
}
"""What each command does, as it is typed."""


def _usage() -> str:
    width = max(map(len, SUMMARY)) + 2
    lines = (f"    cp-env {name:<{width}}{text}" for name, text in SUMMARY.items())
    return "\n".join(
        [
            "usage: cp-env COMMAND [OPTIONS]",
            "",
            "Scenes, films, checks and the cache of cp_env.",
            "",
            *lines,
            "",
            "cp-env COMMAND --help lists the options of one.",
            "Other programs: cp-train, cp-calibrate, cp-play, cp-benchmark, cp-arena.",
        ]
    )


def main(args: list[str] | None = None) -> None:
    """Run the console script; `args` are the command line's unless given. A command may be two words."""
    import sys

    args = sys.argv[1:] if args is None else args
    if not args or args[0] in ("-h", "--help"):
        print(_usage())
        return
    if args[0] == "--version":
        args = ["version", *args[1:]]
    if (command := " ".join(args[:2])) in SUMMARY and len(args) > 1:
        args = args[2:]
    elif (command := args[0].replace("-", " ")) in SUMMARY:
        args = args[1:]
    else:
        from defenders.registry import unknown

        raise SystemExit(f"cp-env: {unknown('command', args[0], tuple(SUMMARY))}")
    try:
        _run(command, args)
    except (ValueError, ImportError) as error:  # bad input, or an extra that is not installed
        raise SystemExit(f"cp-env: {error}") from error


def _run(command: str, args: list[str]) -> None:
    """One command with its options."""
    import tyro

    from cp_env.paths import use_current_folder

    use_current_folder()
    prog = f"cp-env {command}"
    if command == "evaluate":
        from cp_env.detector.training import evaluate

        evaluate.main(tyro.cli(evaluate.Args, prog=prog, description=evaluate.__doc__, args=args))
        return
    commands: dict[str, Callable[..., None]] = {
        "scenes": scenes,
        "scenes export": scenes_export,
        "scenes preview": tyro.conf.configure(tyro.conf.PositionalRequiredArgs)(scenes_preview),
        "play": play,
        "check": check,
        "cache": cache,
        "cache clear": cache_clear,
        "cache bound": tyro.conf.configure(tyro.conf.PositionalRequiredArgs)(cache_bound),
        "version": version,
    }
    tyro.cli(commands[command], prog=prog, args=args)


if __name__ == "__main__":
    main()
