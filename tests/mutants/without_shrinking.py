"""A plugin of pytest: Hypothesis takes the first counterexample as it is; what counts is whether there is one."""

from __future__ import annotations

from hypothesis import Phase, settings

settings.register_profile("without shrinking", phases=(Phase.explicit, Phase.generate))
settings.load_profile("without shrinking")  # profiles that are registered from now on inherit it
