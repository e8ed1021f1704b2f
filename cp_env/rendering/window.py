"""A window that shows an episode. Without a display it draws into memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import UInt8


class Window:
    """Shows one picture after the other; opens with the first. Pickles to a window not yet opened."""

    def __init__(self, title: str, fps: int) -> None:
        self.title = title
        self.fps = fps
        self._figure: Any = None
        self._image: Any = None

    def show(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Draw a picture and let the window breathe for a frame; a window the user closed opens again."""
        from matplotlib import pyplot as plt

        if self._figure is None or not plt.fignum_exists(self._figure.number):
            height, width = picture.shape[:2]
            self._figure = plt.figure(self.title, figsize=(width / 100, height / 100), dpi=100)
            axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set_axis_off()
            self._image = axes.imshow(picture)
        self._image.set_data(picture)
        canvas = self._figure.canvas
        canvas.draw()
        if canvas.required_interactive_framework is not None:  # a real display
            self._figure.show()
            canvas.start_event_loop(1 / self.fps)

    def close(self) -> None:
        """Close the window, if there is one; it may be shown again."""
        if self._figure is not None:
            from matplotlib import pyplot as plt

            plt.close(self._figure)
        self._figure = self._image = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_figure": None, "_image": None}
