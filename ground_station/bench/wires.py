"""`swarmscan bench wires`: what pictures say of wires, beside the truth, along walks over the view lattice.

Every picture says of a place how much likelier it is with a wire there than without one (`line_votes`). Of places on
wires and of places with nothing near, that is counted by what was said and from how far: where pictures are right about
how much they know, the logarithm of the counts' ratio is what they said.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import minimize
from scipy.stats import mannwhitneyu

from ground_station.bench.depth import add_walk_arguments, take_pictures
from ground_station.bench.depth_walking import picture
from missions.console import print_result
from missions.errors import UserError
from missions.frames import Array
from missions.walks import Walks, truth_path, walks_path
from perception.mapping.line_votes import MOST, WIDE_M, Floats, Lines, LineVotes, log_odds
from perception.warm_up import warm_up

SCENES = ("family:h_frame_line:1", "family:tubular_line:1", "family:lattice_line:1", "family:cat_head_line:1",
          "family:concrete_pole_line:1")
REACH_M = 70.0
FROM_M = (WIDE_M, 9.0, 15.0, 22.0, 30.0, 44.0, REACH_M)
SAID = (-MOST, -2.0, -1.2, -0.6, 0.0, 0.6, 1.2, 2.0, MOST)


@dataclass(frozen=True)
class Looks:
    """What pictures showed at n places."""

    distance_m: Array
    line: Floats
    plainly: Floats
    wire: NDArray[np.bool_]
    """Whether there is one."""

    @property
    def said(self) -> Floats:
        """(n,) what the pictures say."""
        return log_odds(self.line, self.plainly)

    @property
    def both(self) -> bool:
        """Whether there are wires and places without any among them."""
        return bool(self.wire.any() and not self.wire.all())

    def between(self, near_m: float, far_m: float) -> Looks:
        """Those from so far."""
        some = (self.distance_m >= near_m) & (self.distance_m < far_m)
        return Looks(*(getattr(self, name)[some] for name in Looks.__dataclass_fields__))


@dataclass(frozen=True)
class Row:
    """Pictures from one range of distances."""

    from_m: float
    to_m: float
    on_wires: int
    on_nothing: int
    said_of_wires: float
    """Mean of what was said, a natural logarithm."""
    said_of_nothing: float
    told_apart: float
    """How often more was said of a wire than of nothing: the area under the ROC curve."""
    should_have_said: list[float]
    """The logarithm of the counts' ratio, for what was said between one of SAID and the next."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parse(argv)
    warm_up()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.data or Path(scratch)
        take_pictures(folder, options)
        parts = [looks for scene in track(options.scenes, "wires", console=Console(stderr=True), disable=options.json)
                 for looks in looks_at(folder, scene)]
    looks = Looks(*(np.concatenate([getattr(part, name) for part in parts]) for name in Looks.__dataclass_fields__))
    if not looks.both:
        raise UserError("--scenes: none of them has wires; give power lines.")
    if options.fit:
        sys.stdout.write(f"{json.dumps(fit(looks))}\n")
        return 0
    rows = [row(looks, near, far) for near, far in pairwise(FROM_M) if looks.between(near, far).both]
    print_result(rows, _table(rows), options.json)
    return 0


def looks_at(folder: Path, scene: str) -> Iterator[Looks]:
    """What each picture of a scene's walks shows at the places of its truth that nothing hides."""
    walks = msgspec.msgpack.decode(walks_path(folder, scene).read_bytes(), type=Walks)
    with np.load(truth_path(folder, scene)) as truth:
        if "wires_enu_m" not in truth:
            raise UserError(f"{truth_path(folder, scene)}: written before wires were; delete it and its pictures.")
        wires, empty, depth_m = truth["wires_enu_m"], truth["empty_enu_m"], truth["depth_m"]
    votes = LineVotes(np.concatenate([wires, empty]), REACH_M)
    for shot, jpeg, surface_m in zip(walks.shots, walks.jpegs, depth_m, strict=True):
        shown = votes.shown(Lines.of(picture(jpeg)), walks.camera, shot.pose, surface_m)
        some = np.flatnonzero(shown.weight == 1.0)
        yield Looks(np.linalg.norm(votes.points_enu_m[some] - shot.pose.position_enu_m, axis=1), shown.line[some],
                    shown.plainly[some], some < len(wires))


def row(looks: Looks, near_m: float, far_m: float) -> Row:
    """What was said from one range of distances, beside the truth."""
    some = looks.between(near_m, far_m)
    of_wires, of_nothing = some.said[some.wire], some.said[~some.wire]
    counts = [np.histogram(said, SAID)[0] + 1.0 for said in (of_wires, of_nothing)]
    true = np.log(counts[0] / counts[0].sum()) - np.log(counts[1] / counts[1].sum())
    apart = mannwhitneyu(of_wires, of_nothing).statistic / (len(of_wires) * len(of_nothing))
    return Row(near_m, far_m, len(of_wires), len(of_nothing), round(float(of_wires.mean()), 2),
               round(float(of_nothing.mean()), 2), round(float(apart), 3), true.round(2).tolist())


def fit(looks: Looks) -> dict[str, float]:
    """The constants of perception.mapping.line_votes by logistic regression, wires and nothing weighing the same."""
    features = np.stack([np.ones_like(looks.line), looks.line, looks.plainly, looks.line * looks.plainly], axis=1)
    sign = np.where(looks.wire, 1.0, -1.0)
    weight = np.where(looks.wire, 0.5 / looks.wire.sum(), 0.5 / (~looks.wire).sum())

    def loss(x: Array) -> tuple[float, Array]:
        margin = sign * (features @ x)
        slope: Array = -features.T @ (weight * sign / (1.0 + np.exp(margin)))
        return float(weight @ np.logaddexp(0.0, -margin)), slope

    found = minimize(loss, np.zeros(4), jac=True)
    return dict(zip(("NONE", "LINE", "PLAINLY", "BOTH"), found.x.round(3).tolist(), strict=True))


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="swarmscan bench wires", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add_walk_arguments(parser, SCENES)
    parser.add_argument("--fit", action="store_true", help="print the constants that these scenes would give instead")
    parser.add_argument("--json", action="store_true", help="one JSON document instead of a table")
    return parser.parse_args(argv)


def _table(rows: Sequence[Row]) -> Table:
    table = Table(title="What one picture says of a place, beside what it should have said")
    between = [f"{a:g} .. {b:g}" for a, b in pairwise(SAID)]
    for heading in ("from m", "on wires", "on nothing", "said", "of nothing", "told apart", *between):
        table.add_column(heading, justify="right")
    for r in rows:
        table.add_row(f"{r.from_m:g} .. {r.to_m:g}", f"{r.on_wires}", f"{r.on_nothing}", f"{r.said_of_wires:.2f}",
                      f"{r.said_of_nothing:.2f}", f"{r.told_apart:.3f}", *(f"{t:.2f}" for t in r.should_have_said))
    return table
