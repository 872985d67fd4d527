"""From what is known of a scene to what the networks take: batches of tensors, normalised as MACARONS does.

The view frame is that of the present camera: x left, y up, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from missions.camera import Camera, Pose
from missions.frames import Array
from perception.macarons.field import Field, in_view
from perception.macarons.gain_net import GainNet, gain, visibility
from perception.macarons.harmonics import view_harmonics
from perception.macarons.occupancy_net import OccupancyNet, neighbourhoods

LEAST_SURFACE_POINTS = 64
"""Cells with no more of them around are not asked about."""
LEAST_OCCUPANCY = 0.1
PLACE_SCALE, VIEW_SCALE = 10.0, 10.0
"""MACARONS divides places by three cell diagonals; times these, untrained layers see differences between places and
between view states, and learn from thousands of updates, not hundreds of thousands."""


def view_from_enu(pose: Pose) -> Array:
    """(3, 3) rotation into the view frame of a camera."""
    result: Array = np.diag([-1.0, -1.0, 1.0]) @ pose.enu_from_camera.T
    return result


@dataclass(frozen=True)
class OccupancyBatch:
    """Queries of some cells, as OccupancyNet takes them; numbers (q,) of the proxies that they are."""

    numbers: NDArray[np.int64]
    tensors: tuple[Tensor, Tensor, Tensor, Tensor, Tensor]

    def predict(self, net: OccupancyNet) -> Tensor:
        """(q,) occupancies."""
        result: Tensor = net(*self.tensors)
        return result


def occupancy_batch(field: Field, queries: NDArray[np.int64], pose: Pose, cloud_points: int,
                    rng: np.random.Generator) -> OccupancyBatch | None:
    """The queries (numbers of proxies) whose cells have enough surface around; None where none have."""
    turn, scale = view_from_enu(pose), PLACE_SCALE / (3.0 * field.cells.diagonal_m)
    centres, cell_of = field.cells.centres(), field.proxy_cell[queries]
    clouds: list[NDArray[np.float32]] = []
    numbers, places, owners, near = [], [], [], []
    for cell in np.unique(cell_of):
        surface = field.surface.near(int(cell))
        if len(surface) <= LEAST_SURFACE_POINTS:
            continue
        cloud = ((surface - centres[cell]) @ turn.T * scale).astype(np.float32)
        mine = queries[cell_of == cell]
        at = ((field.proxies[mine] - centres[cell]) @ turn.T * scale).astype(np.float32)
        owners.append(np.full(len(mine), len(clouds)))
        clouds.append(cloud[rng.integers(0, len(cloud), cloud_points)] if len(cloud) < cloud_points
                      else cloud[rng.permutation(len(cloud))[:cloud_points]])
        near.append(neighbourhoods(cloud, at, rng))
        numbers.append(mine)
        places.append(at)
    if not numbers:
        return None
    asked = np.concatenate(numbers)
    arrays = (np.stack(clouds), np.concatenate(places), np.concatenate(owners), np.concatenate(near))
    a, b, c, d = (torch.from_numpy(array) for array in arrays)
    return OccupancyBatch(asked, (a, b, c, d, VIEW_SCALE * view_harmonics(field.seen_from[asked], turn)))


def joined(batches: list[OccupancyBatch]) -> OccupancyBatch:
    """Queries of several fields in one batch, in this order; numbers are those of each one's own field."""
    clouds, places, owners, near, views = zip(*(batch.tensors for batch in batches), strict=True)
    before = np.cumsum([0] + [len(cloud) for cloud in clouds[:-1]])
    owner = torch.cat([own + int(n) for own, n in zip(owners, before, strict=True)])
    return OccupancyBatch(np.concatenate([batch.numbers for batch in batches]),
                          (torch.cat(clouds), torch.cat(places), owner, torch.cat(near), torch.cat(views)))


@dataclass(frozen=True)
class GainBatch:
    """What candidates have in view, as GainNet takes it."""

    tokens: Tensor
    views: Tensor
    present: Tensor
    to_camera: Tensor
    """(c, n, 3) unit directions in the view frame."""
    drawn: Tensor
    """(c, n) how often each point was drawn."""
    volume: Tensor
    """(c,) sum of the occupancies in view."""

    def predict(self, net: GainNet) -> Tensor:
        """(c,) gains."""
        seen = visibility(net(self.tokens, self.views, self.present), self.to_camera)
        return gain(seen, self.drawn, self.volume)


def gain_batch(field: Field, camera: Camera, poses: list[Pose], here: Pose, samples: int,
               rng: np.random.Generator) -> GainBatch:
    """Candidates' views of the likely solid points, in the view frame of `here`. What sees nothing has volume 0."""
    turn = view_from_enu(here)
    drawn = [_draw(field, camera, pose, samples, rng) for pose in poses]
    width = max([1, *(len(number) for number, _, _ in drawn)])
    c = len(poses)
    tokens, to_camera = (np.zeros((c, width, k), dtype=np.float32) for k in (4, 3))
    to_camera[..., 2] = 1.0
    views = torch.zeros(c, width, 64)
    count = np.zeros((c, width), dtype=np.float32)
    present = np.zeros((c, width), dtype=np.bool_)
    present[:, 0] = True
    for row, (pose, (number, times, _)) in enumerate(zip(poses, drawn, strict=True)):
        n, points = len(number), field.proxies[number]
        if not n:
            continue
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        tokens[row, :n, :3] = (points - middle) @ turn.T / field.diagonal_m
        tokens[row, :n, 3] = field.occupancy[number]
        away = np.array(pose.position_enu_m) - points
        to_camera[row, :n] = (away / np.linalg.norm(away, axis=1, keepdims=True)) @ turn.T
        count[row, :n], present[row, :n] = times, True
        views[row, :n] = VIEW_SCALE * view_harmonics(field.seen_from[number], turn)
    volume = torch.tensor([float(v) for _, _, v in drawn])
    a, b, d, e = (torch.from_numpy(x) for x in (tokens, present, to_camera, count))
    return GainBatch(a, views, b, d, e, volume)


def _draw(field: Field, camera: Camera, pose: Pose, samples: int,
          rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """Proxies drawn with replacement in proportion to their occupancy, how often each, and the sum of occupancies."""
    number, *_ = in_view(field.proxies, camera, pose, field.range_m)
    number = number[field.occupancy[number] > LEAST_OCCUPANCY]
    occupancy = field.occupancy[number].astype(np.float64)
    volume = float(occupancy.sum())
    if not len(number):
        return number, number, 0.0
    at = np.searchsorted(np.cumsum(occupancy) / volume, rng.random(samples), side="right")
    chosen, times = np.unique(np.minimum(at, len(number) - 1), return_counts=True)
    return number[chosen], times, volume
