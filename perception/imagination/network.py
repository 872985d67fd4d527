"""A small 3-D U-Net from what is known of each voxel to how likely the unknown ones are solid.

It reads and writes full resolution but thinks in cells of 2 x 2 x 2 voxels and coarser: strided convolutions go down,
transposed ones back up. Skips are added (after Ronneberger et al., MICCAI 2015, who concatenate); without
normalisation, so that what it says of a place does not depend on what else is in the window.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

CHANNELS = (16, 32, 64)
KNOWN, PLACE = 2, 3
PRIOR_LOGIT = -1.5


class Block(nn.Module):
    """Convolution and ReLU, around which the input is led past."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """(b, c, i, j, k) to the same."""
        result: Tensor = x + torch.relu(self.conv(x))
        return result


class ImaginationNet(nn.Module):
    """known (b, KNOWN, 2i, 2j, 2k) and place (b, PLACE, i, j, k) to logits (b, 2i, 2j, 2k); i, j, k multiples of 4."""

    def __init__(self) -> None:
        super().__init__()
        fine, middle, coarse = CHANNELS
        self.stem = nn.Conv3d(KNOWN, fine, 2, stride=2)
        self.place = nn.Conv3d(PLACE, fine, 1, bias=False)
        self.to_middle = nn.Conv3d(fine, middle, 2, stride=2)
        self.middle = nn.Sequential(Block(middle), Block(middle))
        self.to_coarse = nn.Conv3d(middle, coarse, 2, stride=2)
        self.coarse = nn.Sequential(Block(coarse), Block(coarse), Block(coarse))
        self.from_coarse = nn.ConvTranspose3d(coarse, middle, 2, stride=2)
        self.middle_again = Block(middle)
        self.from_middle = nn.ConvTranspose3d(middle, fine, 2, stride=2)
        self.fine = Block(fine)
        self.head = nn.ConvTranspose3d(fine, 1, 2, stride=2)
        nn.init.constant_(self.head.bias, PRIOR_LOGIT)  # type: ignore[arg-type]

    def forward(self, known: Tensor, place: Tensor) -> Tensor:
        """See the class."""
        fine = torch.relu(self.stem(known) + self.place(place))
        middle = self.middle(torch.relu(self.to_middle(fine)))
        coarse = self.coarse(torch.relu(self.to_coarse(middle)))
        middle = self.middle_again(middle + self.from_coarse(coarse))
        fine = self.fine(fine + self.from_middle(middle))
        result: Tensor = self.head(fine)[:, 0]
        return result
