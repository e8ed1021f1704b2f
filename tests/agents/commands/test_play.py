"""`cp-play` on toy scenes: what is played, what is kept, what is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.commands import play
from agents.commands.play import Args, conditions_of, learned, play_all, scripted, write

SCENES = "tests.helpers.toy_scenes:ToySource:n_frames=3,n_connected=3"


@pytest.fixture
def args(tmp_path: Path) -> Args:
    return Args(
        defenders=("none", "ego_only"),
        attacks=("noise", "pgd:steps=1"),
        policies=("prbi-0",),
        scenes=SCENES,
        n_scenes=1,
        frames=2,
        vehicles=3,
        k=1,
        out=tmp_path,
    )


def test_which_attacks_meet_a_defender() -> None:
    assert scripted("prbi", Args())[0] == play.THRESHOLD_AWARE["prbi"] and scripted("none", Args()) == list(play.COMMON)
    assert scripted("prbi", Args(attacks=("pgd",))) == ["pgd"]
    shipped = learned("prbi", Args())
    assert "policy:name=prbi-0" in shipped and not any("robosac" in spec for spec in shipped)
    assert learned("mine:Halves", Args(policies=("a.safetensors",))) == ["policy:name=a.safetensors"]


def test_episodes_are_kept_and_told(
    args: Args, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    conditions = conditions_of(args)
    played = play_all(args, conditions)
    assert "plan: 6 attacks on 2 defenders, 1 episodes of 2 frames" in capsys.readouterr().err
    text = write(played, args)
    assert text.count("Against ") == 2 and "policy:name=prbi-0 does" in text
    assert (args.out / "attacks.md").read_text() == text + "\n"
    monkeypatch.setattr(play, "play", None)  # nothing is played again
    again = play_all(args, conditions)
    assert {run: e.damage.tolist() for run, e in again.items()} == {run: e.damage.tolist() for run, e in played.items()}


def test_the_programs_film(args: Args) -> None:
    assert play.film(args, conditions_of(args)).read_bytes()[:3] == b"GIF"


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"cp-play: .*holds 2 scenes"):
        play.main(["--scenes", SCENES, "--n-scenes", "5", "--out", str(tmp_path)])
