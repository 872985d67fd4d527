"""A command or its answer that is lost on the way."""

from __future__ import annotations

import threading

import pytest

from ground_station import connect
from missions import live, topics
from missions.bus import Bus
from missions.clock import BRIDGE
from missions.errors import LinkError
from missions.live import OperatorAnswer, OperatorCommand
from tests.loopback import free_endpoint


def commands(bus: Bus, count: int) -> list[OperatorCommand]:
    heard: list[OperatorCommand] = []
    while len(heard) < count:
        heard += [d.message for d in bus.poll(timeout_s=None) if isinstance(d.message, OperatorCommand)]
    return heard


def test_a_command_is_sent_again_with_its_id_until_it_is_answered() -> None:
    endpoint, heard = free_endpoint(), list[OperatorCommand]()
    with Bus(BRIDGE, "test", listen=endpoint) as bus:
        bus.subscribe(topics.OPERATOR_COMMAND)
        bus.announce_alive()

        def ground() -> None:
            heard.extend(commands(bus, 2))
            bus.publish(topics.OPERATOR_ANSWER, OperatorAnswer(command_id=heard[0].command_id, accepted=True, text=""))

        thread = threading.Thread(target=ground)
        thread.start()
        with connect(endpoint=endpoint, fleet="test") as mission:
            assert mission.home(2).accepted
            thread.join()
            with pytest.raises(LinkError, match="did not answer"):
                mission.do(live.Start(), timeout_s=0.2)
    assert heard[0] == heard[1]
    assert heard[0].action == live.Home(vehicle_id=2)
