"""Pictures whose place in a model their own pairs confirm.

A mapper finds a place for pictures whose pairs contradict each other, too: far away from all, or between. The lines
that the model's poses draw into such a picture then miss its matches.
"""

from __future__ import annotations

from pathlib import Path

import networkx as nx
import numpy as np
import pycolmap

from perception.reconstruct.optics import Optics
from perception.reconstruct.pair_consensus import LEAST_SHARE, off_line_px
from perception.reconstruct.pictures import SurveyPicture

NEAR_TIMES = 2.0
"""Matches as near to their lines are confirmed, in limits of the pairs: the model has to please them all."""

Model = pycolmap.Reconstruction


def leave_out_unconfirmed(model: Model, database: Path, near_px: float) -> list[int]:
    """Takes out of the model, and returns, the images that do not hang together with most others by confirmed pairs,
    or by one pair alone, which would not tell how large what hangs by it is. near_px: for matches of the verified pairs
    in the database. The cameras are of model OPENCV."""
    graph = nx.Graph()
    graph.add_nodes_from(sorted(model.reg_image_ids()))
    graph.add_edges_from(confirmed_pairs(model, database, NEAR_TIMES * near_px))
    graph.remove_edges_from(list(nx.bridges(graph)))
    together = max(nx.connected_components(graph), key=len)
    left_out = [i for i in graph if i not in together]
    for i in left_out:
        model.deregister_frame(model.image(i).frame_id)
    return left_out


def confirmed_pairs(model: Model, database: Path, near_px: float) -> list[tuple[int, int]]:
    """Images of the model, most of whose verified matches lie near the epipolar lines of its poses."""
    with pycolmap.Database.open(database) as kept:
        ideal = {i: Optics.of(model.camera(model.image(i).camera_id)).ideal(np.asarray(kept.read_keypoints(i))[:, :2])
                 for i in model.reg_image_ids()}
        pair_ids, geometries = kept.read_two_view_geometries()
    standing = {i: _standing(model, i) for i in ideal}
    pairs = [pycolmap.pair_id_to_image_pair(pair_id) for pair_id in pair_ids]
    found = []
    for (a, b), geometry in sorted(zip(pairs, geometries, strict=True), key=lambda pair: pair[0]):
        matches = np.asarray(geometry.inlier_matches)
        if a in ideal and b in ideal and len(matches):
            off_px = off_line_px(standing[a], standing[b], ideal[a][matches[:, 0]], ideal[b][matches[:, 1]])
            if np.mean(off_px < near_px) >= LEAST_SHARE:
                found.append((a, b))
    return found


def _standing(model: Model, image_id: int) -> SurveyPicture:
    """As a pinhole in the model's own coordinates; there is no file."""
    image = model.image(image_id)
    pose = image.cam_from_world().inverse()
    camera = Optics.of(model.camera(image.camera_id)).camera
    return SurveyPicture(image_id, Path(), camera, pose.rotation.matrix(), np.asarray(pose.translation))
