"""Pictures of a run, small."""

from __future__ import annotations

import cv2
import numpy as np

from ground_station.report.run_data import RunData
from ground_station.report.splat import Pixels

THUMBNAIL_PX = 560


def thumbnail(data: RunData, path: str, width_px: int = THUMBNAIL_PX) -> Pixels:
    """(h, width_px, 3) of a picture by its path in the run folder; grey, with a note, where it cannot be read."""
    picture = cv2.imread(str(data.run.root / path), cv2.IMREAD_COLOR)
    if picture is None:
        data.notes.append(f"{path} is not a readable picture.")
        return np.full((9 * width_px // 16, width_px, 3), 200, dtype=np.uint8)
    height = round(picture.shape[0] * width_px / picture.shape[1])
    return np.asarray(cv2.resize(picture, (width_px, height), interpolation=cv2.INTER_AREA)[:, :, ::-1])
