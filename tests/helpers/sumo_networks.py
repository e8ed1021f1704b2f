"""Small networks and configurations of the simulator, made where they are needed."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

NET = """<net version="1.20">
    <edge id=":j_0" function="internal">
        <lane id=":j_0_0" index="0" speed="9" length="8" shape="-4,-1.6 4,-1.6"/>
    </edge>
    <edge id=":j_w0" function="walkingarea"><lane id=":j_w0_0" index="0" shape="0,0 1,1" allow="pedestrian"/></edge>
    <edge id="in" from="west" to="j">
        <lane id="in_0" index="0" speed="9" length="96" width="2" shape="-100,-4.2 -4,-4.2" allow="pedestrian"/>
        <lane id="in_1" index="1" speed="9" length="96" shape="-100,-1.6 -4,-1.6" disallow="tram rail"/>
    </edge>
    <edge id="out" from="j" to="east">
        <lane id="out_0" index="0" speed="9" length="96" shape="4,-1.6 100,-1.6"/>
    </edge>
    <edge id="rails" from="j" to="east"><lane id="rails_0" index="0" shape="4,5 100,5" allow="rail"/></edge>
    <junction id="west" type="dead_end" x="-100" y="0" shape="-100,0 -100,-3.2"/>
    <junction id="j" type="traffic_light" x="0" y="0" shape="-4,0 4,0 4,-3.2 -4,-3.2"/>
    <junction id="east" type="dead_end" x="100" y="0" shape="100,0 100,-3.2"/>
</net>
"""
"""One street with signals in the middle, a sidewalk and rails."""


def netgenerate(path: Path, *options: str) -> Path:
    """A network of netgenerate's, written to `path`; the test is skipped without the simulator."""
    return _run("netgenerate", path, *options)


def netconvert(path: Path, nodes: str, edges: str) -> Path:
    """A network of netconvert's from the XML of its nodes and edges, written to `path`."""
    files = path.with_suffix(".nod.xml"), path.with_suffix(".edg.xml")
    files[0].write_text(f"<nodes>{nodes}</nodes>")
    files[1].write_text(f"<edges>{edges}</edges>")
    return _run("netconvert", path, "-n", str(files[0]), "-e", str(files[1]), "--offset.disable-normalization")


def _run(tool: str, path: Path, *options: str) -> Path:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    sumo = pytest.importorskip("sumo", reason="needs the extra sumo")
    command = [f"{sumo.SUMO_HOME}/bin/{tool}", *options, "-o", str(path), "--no-warnings"]
    subprocess.run(command, check=True, capture_output=True)
    return path


def configuration(net: Path, routes: str, *, more: str = "", stem: str = "town") -> Path:
    """A configuration next to `net` whose route file holds `routes`; `more` is XML of its own."""
    (net.parent / f"{stem}.rou.xml").write_text(f"<routes>{routes}</routes>")
    path = net.parent / f"{stem}.sumocfg"
    path.write_text(
        f'<configuration><input><net-file value="{net.name}"/><route-files value="{stem}.rou.xml"/></input>'
        f"{more}</configuration>"
    )
    return path
