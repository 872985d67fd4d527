"""Doors with a signing key: who holds it is obeyed, everybody else is refused, counted and told of."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mav

from missions.errors import UserError
from missions.mavlink import Endpoint
from missions.mission import MavlinkSpec
from missions.signing import Signing
from tests.door_world import GCS, Client, DoorWorld

KEY = bytes(range(32))


def signed_doors(tmp_path: Path) -> MavlinkSpec:
    path = tmp_path / "key"
    path.write_text(KEY.hex())
    path.chmod(0o600)
    return MavlinkSpec(open=["udpin://127.0.0.1:14540"], signing_key=str(path))


@pytest.fixture
def world(tmp_path: Path) -> DoorWorld:
    return DoorWorld(tmp_path, mavlink=signed_doors(tmp_path))


def with_key(client: Client, key: bytes) -> Client:
    client.endpoint = Endpoint(*client.ids, Signing(key))
    return client


def test_who_holds_the_key_is_obeyed_and_hears_signed_frames(world: DoorWorld) -> None:
    judge, client = Signing(KEY), with_key(world.client(), KEY)
    assert client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert client.heard
    assert all(judge.accepts(bytes(m.get_msgbuf())) for m in client.heard)


@pytest.mark.parametrize(("key", "reason"), [(None, "unsigned"), (KEY[::-1], "wrong signature")],
                         ids=["unsigned", "wrong"])
def test_everybody_else_is_refused_counted_and_told_of(world: DoorWorld, key: bytes | None, reason: str) -> None:
    client = world.client(ids=GCS)
    if key is not None:
        with_key(client, key)
    with pytest.raises(AssertionError, match="nothing came"):
        client.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    assert not world.vehicles[1].executor.armed
    world.run(12.0)
    told = [m.text for m in client.heard if m.get_type() == "STATUSTEXT"]
    assert [t for t in told if t.startswith("frames refused at the door: ") and t.endswith(reason)]
    assert len(told) <= 3  # not one for every frame


def test_a_key_that_others_may_read_stops_the_vehicle_from_starting(tmp_path: Path) -> None:
    spec = signed_doors(tmp_path)
    Path(spec.signing_key).chmod(0o644)
    with pytest.raises(UserError, match="others than its owner"):
        DoorWorld(tmp_path, mavlink=spec)
