"""The small cut: the report with every hostile name in a real browser; and what runs or overflows is seen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.campaign import pages
from tests.campaign.case import Fault
from tests.helpers.browser import CHROMIUM, DRIVER, Browser, browser

BROWSER = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no chromium and chromedriver: apt-get install them")


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser") / "profile") as opened:
        yield opened


@BROWSER
def test_a_report_shows_hostile_names_as_text_and_fits(window: Browser, tmp_path: Path) -> None:
    page = pages.write(tmp_path, pages.specs())
    window.open(page)
    found = pages.check(window, page, pages.specs())
    assert found["names"] == len(pages.NAMES) >= 20


PAGES = {
    "runs": ("<script>hacked=1</script><td>a</td>", "a name was run"),
    "asks": ("<table><tr><td>a</td></tr></table><img src='missing.png'>", "complains|asked"),
    "hides": ("<table><tr><td>b</td></tr></table>", "not shown as they are: .'a'"),
    "overflows": ("<table><tr><td>a</td></tr></table><div style='width:3000px'>w</div>", "wider than a window of 420"),
}


@BROWSER
@pytest.mark.parametrize("kind", PAGES)
def test_a_page_that_does_not_hold_is_seen(window: Browser, kind: str, tmp_path: Path) -> None:
    body, message = PAGES[kind]
    page = tmp_path / "page.html"
    page.write_text(
        f"<!doctype html><html><head><meta charset='utf-8'><title>t</title></head><body>{body}</body></html>"
    )
    window.log("browser")
    window.requests()
    window.open(page)
    with pytest.raises(Fault, match=message):
        pages.check(window, page, ["a"])


def test_specs_are_names_that_can_be_given() -> None:
    from defenders.registry import Spec

    assert [Spec.parse(spec).options["name"] for spec in pages.specs()] == list(pages.NAMES.values())
