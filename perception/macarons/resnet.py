"""The ResNet-18 trunk (He, Zhang, Ren & Sun, CVPR 2016), without its classifier."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample = nn.Sequential() if stride == 1 else nn.Sequential(
            nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """(b, outputs, h / stride, w / stride)."""
        y = functional.relu(self.bn1(self.conv1(x)))
        return functional.relu(self.bn2(self.conv2(y)) + self.downsample(x))


class Trunk(nn.Module):
    """11,176,512 parameters, named as in the weights that are published for ImageNet."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1 = _layer(64, 64, 1)
        self.layer2 = _layer(64, 128, 2)
        self.layer3 = _layer(128, 256, 2)
        self.layer4 = _layer(256, 512, 2)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def stem(self, rgb: Tensor) -> tuple[Tensor, Tensor]:
        """(b, 64, h / 2, w / 2) first convolution and (b, 64, h / 4, w / 4) features of pictures (b, 3, h, w)."""
        first = functional.relu(self.bn1(self.conv1(rgb)))
        return first, self.layer1(functional.max_pool2d(first, 3, 2, 1))

    def deep(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Layers 2 to 4 from (b, 64, h / 4, w / 4): 128, 256 and 512 channels at 1/8, 1/16 and 1/32."""
        second = self.layer2(features)
        third = self.layer3(second)
        return second, third, self.layer4(third)


def _layer(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    return nn.Sequential(ResidualBlock(inputs, outputs, stride), ResidualBlock(outputs, outputs, 1))


def parameters(module: nn.Module) -> int:
    """Number of trainable values."""
    return sum(p.numel() for p in module.parameters())


def finite(module: nn.Module) -> bool:
    """Whether no weight has run away."""
    return all(bool(torch.isfinite(p).all()) for p in module.parameters())
