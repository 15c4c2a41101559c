"""One look at the mates, whatever their number and order."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

MASKED_SCORE = -1e4  # finite, so that a softmax over nobody stays a number


class MatesAttention(nn.Module):
    """What a robot asks of its mates: heads of softmax-weighted sums over those of which ``mask`` is set.

    Since there is one query a row, keys and values are not worked out for each mate: the query is put in the space of
    the embedded mates, and the values are taken of their sums, which is the same and cheaper. Source: Vaswani et al.,
    "Attention is all you need", 2017, section 3.2.
    """

    def __init__(self, entries: int, query_width: int, width: int, heads: int) -> None:
        super().__init__()
        self.heads, self.width = heads, width
        self.embed = nn.Linear(entries, width)
        self.query = nn.Linear(query_width, heads * width)
        self.values = nn.Linear(heads * width, width)

    def forward(self, asking: Tensor, mates: Tensor, mask: Tensor) -> Tensor:
        """(n, query_width), (n, mates, entries) and (n, mates) to (n, width)."""
        embedded = functional.relu(self.embed(mates))
        queries = self.query(asking).unflatten(-1, (self.heads, self.width))
        scores = torch.matmul(queries, embedded.transpose(1, 2)) / math.sqrt(self.width)
        seen = (mask > 0).unsqueeze(1)
        weights = torch.softmax(scores.masked_fill(~seen, MASKED_SCORE), dim=-1) * seen
        return functional.relu(self.values(torch.matmul(weights, embedded).flatten(1)))
