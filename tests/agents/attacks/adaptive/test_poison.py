"""The attack on the reference of the first frame."""

from __future__ import annotations

from cp_env.world.scene_cache import SceneBank
from tests.helpers.attacked_scenes import damage, play


def test_poison_attacks_in_the_first_frame_and_is_normal_ever_after(street: SceneBank) -> None:
    outcomes = play(street, "poison", grace_frames=0)
    assert outcomes[0].damage.min() > 0.5
    assert min(o.similarity.min() for o in outcomes[1:]) >= 0.35
    assert damage(outcomes) > 0.8 and not any(o.verifications.any() for o in outcomes)
