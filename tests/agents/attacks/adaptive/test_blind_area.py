"""The attack in the area that the ego has not seen."""

from __future__ import annotations

import torch

from agents.attacks.adaptive.blind_area import seen_by_ego, unseen
from tests.helpers import situations
from tests.helpers.attacked_scenes import MODEL, act


def test_blind_attackers_touch_only_what_the_ego_has_not_seen() -> None:
    situation = situations.situation(MODEL)
    seen, free = seen_by_ego(situation), unseen(situation)
    assert not seen[:, :, :6].any() and seen[:, :, 9:].any()
    delta = act("blind", situation, target_groups="everyone")
    touched = delta.abs().amax(2) > 0
    assert free.any() and not free.all() and touched.any()
    assert not (touched & ~free).any()
    pose = torch.take_along_dim(situation.ego_T_sender, situation.attackers[..., None], 1)
    arrived = MODEL.warp(delta, pose).abs().amax(2) > 1e-6
    assert not (arrived & seen[:, None]).any()
