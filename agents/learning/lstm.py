"""The LSTM cell of a recurrent policy, and its state in every environment."""

from __future__ import annotations

from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import linear


@dataclass(eq=False)
class Memory:
    """A long short-term memory (Hochreiter and Schmidhuber 1997), its g = 4h gates in torch's order.

    That is: input, forget, cell, output.
    """

    weight_ih: Float[Tensor, "g d"]
    weight_hh: Float[Tensor, "g h"]
    bias_ih: Float[Tensor, " g"]
    bias_hh: Float[Tensor, " g"]
    _state: tuple[Tensor, Tensor] | None = field(default=None, init=False, repr=False)  # hidden and cell, [n, h] each

    def reset(self) -> None:
        """Forget everything: new episodes begin in all environments."""
        self._state = None

    def __call__(self, observations: Float[Tensor, "n d"]) -> Float[Tensor, "n h"]:
        """The hidden state after one more frame of every environment.

        Raises:
            ValueError: the number of environments is not that of the frame before.
        """
        if self._state is None:
            nothing = observations.new_zeros(len(observations), self.weight_hh.shape[1])
            self._state = nothing, nothing
        hidden, cell = self._state
        if len(hidden) != len(observations):
            raise ValueError(f"the policy remembers {len(hidden)} attackers, not {len(observations)}: reset() it first")
        gates = linear(observations, self.weight_ih, self.bias_ih) + linear(hidden, self.weight_hh, self.bias_hh)
        let_in, keep, new, let_out = gates.chunk(4, dim=-1)
        cell = keep.sigmoid() * cell + let_in.sigmoid() * new.tanh()
        self._state = let_out.sigmoid() * cell.tanh(), cell
        return self._state[0]
