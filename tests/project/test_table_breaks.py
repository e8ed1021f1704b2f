"""Where the site's tables break their lines: intervals and bounds stay whole, names break after punctuation."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    """The hook, which stands outside all packages."""
    spec = spec_from_file_location("tables", ROOT / "docs/tables.py")
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("cell", "held"),
    [
        ("0.195 [0.145, 0.331]", "0.195 [0.145,\u00a00.331]"),
        ("-0.775 [-0.827, -0.722]", "-0.775 [-0.827,\u00a0-0.722]"),
        ("0.003 [\u22120.001, 0.008]", "0.003 [\u22120.001,\u00a00.008]"),
        ("&lt; 0.01", "&lt;\u00a00.01"),
        ("if n &lt; m, [a, b]", "if n &lt; m, [a, b]"),
        ("<code>pasac:score=similarity</code>", "<code>pasac:<wbr>score=<wbr>similarity</code>"),
        ("<code>robust_prbi</code> or not", "<code>robust_<wbr>prbi</code> or not"),
        ("<code>0.3.</code> a.b", "<code>0.<wbr>3.</code> a.b"),
    ],
)
def test_a_cell(tables: ModuleType, cell: str, held: str) -> None:
    assert tables.prepared(cell) == held


def test_text_outside_tables_is_left_alone(tables: ModuleType) -> None:
    html = "<p>0.1 [0.0, 0.2]</p><td style='x'>0.1 [0.0, 0.2]</td><p><code>a_b</code></p>"
    made = tables.on_page_content(html, None, None, None)
    assert made == "<p>0.1 [0.0, 0.2]</p><td style='x'>0.1 [0.0,\u00a00.2]</td><p><code>a_b</code></p>"
