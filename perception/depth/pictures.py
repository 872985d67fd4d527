"""Depth of pictures as they come in: sources are chosen, depth estimated, and checked against the neighbours'."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from missions.camera import Camera, Pose
from perception.depth.confidence import (
    BEYOND,
    FAR_M,
    Confidence,
    Evidence,
    features,
    probability,
    shipped,
    trusted,
)
from perception.depth.depth_map import DepthMap, Image
from perception.depth.filling import filled
from perception.depth.fusion import Consensus, consensus
from perception.depth.plane_sweep import Frame, SweepSettings, estimate, make_frame
from perception.depth.sources import choose_sources

CANDIDATES = 48
"""Nearest pictures considered as sources."""
VOTERS = 12
"""Nearest pictures whose depth maps are heard."""
NEAR_M = 7.0
"""New pictures further away than this are no reason to look for better sources."""
BETTER = 1.2
"""A picture is estimated anew when the worth of its sources has grown by this factor."""


@dataclass
class _Picture:
    frame: Frame
    raw: DepthMap | None = None
    depth: DepthMap | None = None
    score: float = 0.0
    estimates: int = 0


class PictureDepths:
    """Pictures with poses in, depth maps out. Deterministic: the same calls give the same depth on any thread count."""

    def __init__(self, settings: SweepSettings | None = None, sources: int = 6, min_sources: int = 2,
                 workers: int = 4, confidence: Confidence | None = None) -> None:
        self._sweep, self._confidence = settings or SweepSettings(), confidence or shipped()
        self._count, self._least = sources, min_sources
        self._pictures: list[_Picture] = []
        self._considered = 0
        self._workers = ThreadPoolExecutor(workers)

    def __len__(self) -> int:
        return len(self._pictures)

    def add(self, rgb: NDArray[np.uint8], camera: Camera, pose: Pose) -> int:
        """Takes a picture (h, w, 3) in; returns its index. Nothing is estimated before `update`."""
        self._pictures.append(_Picture(make_frame(rgb, camera, pose, self._sweep.shrink)))
        return len(self._pictures) - 1

    def update(self) -> list[int]:
        """Estimates every picture that has enough sources by now; indices of pictures estimated, or estimated anew."""
        affected = self._affected()
        work = [(i, sources) for i, sources in zip(affected, self._workers.map(self._new_sources, affected),
                                                   strict=True) if sources]
        self._considered = len(self._pictures)
        frames = [(self._pictures[i].frame, [self._pictures[k].frame for k in sources]) for i, sources in work]
        raw = self._workers.map(lambda pair: estimate(pair[0], pair[1], self._sweep), frames)
        indices = [i for i, _ in work]
        for i, depth in zip(indices, raw, strict=True):
            self._pictures[i].raw = depth
        for i, depth in zip(indices, self._workers.map(self._checked, indices), strict=True):
            self._pictures[i].depth = depth
        return indices

    def depth(self, index: int) -> DepthMap | None:
        """The newest depth map of a picture, if there is any."""
        return self._pictures[index].depth

    def _affected(self) -> list[int]:
        """Pictures that may be estimated for the first or second time because of those added since the last update."""
        position = np.array([p.frame.pose.position_enu_m for p in self._pictures]).reshape(-1, 3)
        new = position[self._considered :]
        return [i for i, p in enumerate(self._pictures)
                if p.estimates < 2 and (np.linalg.norm(new - position[i], axis=1) < NEAR_M).any()]

    def _new_sources(self, index: int) -> list[int]:
        """Sources for a picture that has no depth yet, or that can have a much better one; else nothing."""
        picture = self._pictures[index]
        if picture.estimates >= 2:
            return []
        near = self._near(index)
        poses = [self._pictures[i].frame.pose for i in near]
        chosen, score = choose_sources(picture.frame.pose, poses, picture.frame.camera, self._count)
        if len(chosen) < self._least or (picture.estimates == 1 and score < BETTER * picture.score):
            return []
        picture.score, picture.estimates = score, picture.estimates + 1
        return [near[i] for i in chosen]

    def _checked(self, index: int) -> DepthMap:
        """A picture's depth map checked against those of its neighbours."""
        depth, vote = self._vote(index)
        frame, (offset, slope) = self._pictures[index].frame, self._confidence.filled
        evidence = features(depth, vote, frame)
        odds = self._confidence.log_odds(evidence)
        good = trusted(odds, vote.depth_m, evidence)
        guess = filled(vote.depth_m, good & ~depth.sky, frame.gray)
        beyond = (vote.depth_m > FAR_M) & (odds >= BEYOND) & ~good & ~depth.sky
        odds = np.where(good, odds, offset + slope * odds)
        return replace(depth, depth_m=guess, valid=good & ~depth.sky, beyond=beyond, confidence=probability(odds))

    def evidence(self, index: int) -> tuple[Image, Evidence]:
        """For a picture that has been estimated: (h, w) depth as the vote has it by now, and (features, h, w) what its
        confidence is reckoned from."""
        depth, vote = self._vote(index)
        return vote.depth_m, features(depth, vote, self._pictures[index].frame)

    def _vote(self, index: int) -> tuple[DepthMap, Consensus]:
        """A picture's own estimate, and what its neighbours make of it."""
        own = self._pictures[index]
        others = [p for i in self._near(index)[:VOTERS] if (p := self._pictures[i]).raw is not None]
        assert own.raw is not None
        return own.raw, consensus(own.raw, own.frame.gray, [p.raw for p in others if p.raw is not None],
                                  [p.frame.gray for p in others])

    def _near(self, index: int) -> list[int]:
        """Other pictures, nearest first."""
        position = np.array([p.frame.pose.position_enu_m for p in self._pictures])
        order = np.argsort(np.linalg.norm(position - position[index], axis=1), kind="stable")
        return [int(i) for i in order if i != index][:CANDIDATES]
