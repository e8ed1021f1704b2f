"""Rendering of one world, shared by the PettingZoo and the gymnasium environment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cp_env.envs.core import Game
from cp_env.rendering.window import Window
from defenders.registry import shown

RENDER_MODES = ("human", "rgb_array")
RENDER_FPS = 5  # as many frames as the recordings have a second


def check_render_mode(mode: str | None) -> str | None:
    """The mode itself. ValueError if there is no such mode."""
    if mode is not None and not (isinstance(mode, str) and mode in RENDER_MODES):
        raise ValueError(f"render_mode must be None or one of {list(RENDER_MODES)}, got {shown(mode)}")
    return mode


class RenderMixin:
    """Render methods of an environment of one world, `game`."""

    def show(self, game: Game, render_mode: str | None) -> None:
        """The game to draw, and how: None, "rgb_array" or "human". ValueError for another mode."""
        self.game, self.render_mode = game, check_render_mode(render_mode)
        self._window = Window("collaborative perception", RENDER_FPS)

    def render(self) -> NDArray[np.uint8] | None:
        """The picture (h, w, 3) of this frame for "rgb_array"; for "human" the window is brought up to date."""
        if self.render_mode == "rgb_array":
            return self.game.render(0)
        self._follow()
        return None

    def close(self) -> None:
        """Close the window. Closing twice is no error."""
        self._window.close()

    def _follow(self) -> None:
        if self.render_mode == "human":
            self._window.show(self.game.render(0))
