"""What the pictures so far have shown of a map that still changes."""

from __future__ import annotations

from missions.camera import Camera, Pose
from planning.nbv.sights import ImaginedMap, Shown

AGAIN = 8
"""Earlier pictures whose faces are reckoned anew each time, those longest ago first."""


class ShownFaces:
    """The faces that each picture has shown. A new picture is looked up in the map at once, earlier ones in turn: the
    map may have changed before or behind what they show. So the cost does not grow with the number of pictures."""

    def __init__(self, camera: Camera, range_m: float) -> None:
        self._camera, self._range_m = camera, range_m
        self._poses: list[Pose] = []
        self._shown: dict[int, Shown] = {}
        """By picture, the one reckoned longest ago first."""

    def add(self, pose: Pose) -> None:
        """A picture was taken."""
        self._poses.append(pose)

    def take_out(self, imagined: ImaginedMap) -> None:
        """What the pictures have shown is not new any more."""
        new = range(len(self._shown), len(self._poses))
        for picture in [*list(self._shown)[:AGAIN], *new]:
            self._shown.pop(picture, None)
            self._shown[picture] = imagined.shown_by(self._poses[picture], self._camera, self._range_m)
        for shown in self._shown.values():
            imagined.count_as_shown(shown)
