"""The gallery: its films are there, small, on the page, and drawn anew by one command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cp_env.rendering.picture import Picture
from examples.reproduce import gallery
from examples.reproduce.gallery import ATTACKS, DEFENDERS, Args, draw_teaser, figures_of, films_of, main
from tests.helpers.drawn_frames import NOTHING, boxes, detections

ROOT = Path(__file__).parents[2]
BENIGN = replace(
    NOTHING, places=np.zeros((5, 2)), truth=boxes((5, 5)), output=detections((5, 5)), seen=detections((5, 5))
)
ATTACKED = replace(BENIGN, seen=detections((20, 20)), damage=0.5, verifications=2, attackers=frozenset({1, 2}))


def test_every_film_is_there_small_and_on_the_page() -> None:
    films, page = films_of(Args()), (ROOT / "docs/gallery.md").read_text()
    assert len({film.name for film in films}) == len(films) == len(DEFENDERS) * len(ATTACKS) + 2
    for film in films:
        file = ROOT / "docs/gallery" / f"{film.name}.gif"
        assert file.stat().st_size <= gallery.MOST and page.count(f"(gallery/{film.name}.gif)") == 1
    assert {file.stem for file in (ROOT / "docs/gallery").iterdir()} == {film.name for film in films}


def test_figures_of_an_episode_by_hand() -> None:
    last = replace(ATTACKED, suspects=frozenset({1, 4}), verifications=0)
    figures = figures_of([BENIGN, ATTACKED, last])
    assert (figures.loss, figures.verifications) == pytest.approx((1 / 3, 2 / 3))
    assert (figures.suspected, figures.misclassified) == (1, 1)


def test_the_teaser_shows_one_moment_three_times(tmp_path: Path) -> None:
    path = draw_teaser(BENIGN, ATTACKED, tmp_path / "teaser.png")
    with Image.open(path) as image:
        assert image.width == 1400
        pixels = np.asarray(image.convert("RGB"))
    first, second, third = (pixels[96:544, left : left + 448] for left in (14, 476, 938))
    assert (first != second).any() and (second != third).any()
    for other in (replace(ATTACKED, frame=9), replace(ATTACKED, truth=boxes((1, 1)))):
        with pytest.raises(ValueError, match="must show one moment"):
            draw_teaser(BENIGN, other, path)


def test_one_command_writes_films_teaser_and_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def record(film: gallery.Film, args: Args) -> list[Picture]:
        frames = [BENIGN, BENIGN if film.attack == "none" else ATTACKED, BENIGN]
        return [replace(picture, frame=number) for number, picture in enumerate(frames)]

    monkeypatch.setattr(gallery, "record", record)
    page = tmp_path / "page.md"
    page.write_text(f"before\n{gallery.BEGIN}\nformer films\n{gallery.END}\nafter\n")
    args = Args(out=tmp_path / "films", page=page, teaser=tmp_path / "teaser.png")
    main(args)
    text = page.read_text()
    assert text.startswith(f"before\n{gallery.BEGIN}\n## PGD\n") and text.endswith(f"{gallery.END}\nafter\n")
    assert "former films" not in text and text.count("(films/") == len(DEFENDERS) * len(ATTACKS)
    assert "| `bayes` | 0.17 | 0.67 | 0 of 2 | 0 |" in text
    assert (tmp_path / "teaser.png").is_file() and len(list(args.out.iterdir())) == len(films_of(args))
    with pytest.raises(ValueError, match="no film 'pgd'; known: none-pgd"):
        main(replace(args, films=("pgd",)))
