"""Two ground stations and one vehicle: exactly one leads, everybody may make it safer."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from vehicle.failsafe_table import Action
from vehicle.lease import EXPIRES_NS, REMEMBERED, Lease

QGC, MAVSDK, MAVPROXY = (255, 190), (245, 190), (255, 230)
NS = 1_000_000_000


def test_the_first_that_commands_flight_leads_until_its_heartbeat_is_gone() -> None:
    lease = Lease()
    assert lease.take(MAVSDK, 0)
    assert not lease.take(QGC, NS)
    lease.heard(MAVSDK, 5 * NS)
    lease.heard(QGC, 6 * NS)
    assert lease.leader_heard_ns == 5 * NS
    assert not lease.take(QGC, 5 * NS + EXPIRES_NS)
    assert lease.holder_name == "ground station 245"
    assert lease.take(QGC, 5 * NS + EXPIRES_NS + 1)
    lease.heard(MAVSDK, 6 * NS + EXPIRES_NS)
    assert not lease.take(MAVSDK, 6 * NS + EXPIRES_NS)


def test_two_programs_of_one_system_are_two_ground_stations() -> None:
    lease = Lease()
    assert lease.take(QGC, 0)
    assert not lease.take(MAVPROXY, 0)


def test_our_ground_station_leads_while_it_is_there_and_leaves_nobody_leading() -> None:
    lease = Lease()
    assert lease.take(MAVSDK, 0)
    lease.ground_leads = True
    assert not lease.take(MAVSDK, NS)
    assert lease.holder_name == "swarmscan's ground station"
    assert not lease.may_set(MAVSDK, NS)
    lease.ground_leads = False
    assert lease.may_set(QGC, NS), "nobody leads"
    assert lease.take(QGC, NS)


def test_a_hand_over_is_the_leaders_to_make() -> None:
    lease = Lease()
    assert lease.take(MAVSDK, 0)
    lease.let_go(QGC)
    assert not lease.take(QGC, 0)
    lease.let_go(MAVSDK)
    assert lease.take(QGC, 0)


@pytest.mark.parametrize("wish", [Action.HOLD, Action.RETURN, Action.LAND])
@pytest.mark.parametrize("doing", [Action.NONE, Action.HOLD, Action.RETURN, Action.LAND])
def test_a_watcher_may_make_it_safer_and_never_less_safe(wish: Action, doing: Action) -> None:
    lease = Lease()
    assert lease.take(MAVSDK, 0)
    assert lease.may(QGC, wish, doing, 0) is (wish >= doing)
    assert lease.may(MAVSDK, wish, doing, 0)
    assert not lease.may(QGC, Action.NONE, doing, 0)
    assert not lease.may_set(QGC, 0)
    assert lease.may_set(MAVSDK, 0)
    assert lease.take(MAVSDK, 0), "a watcher's call does not change who leads"


def test_strangers_do_not_fill_the_memory_nor_push_the_leader_out() -> None:
    lease = Lease()
    assert lease.take(MAVSDK, 0)
    for n in range(10 * REMEMBERED):
        lease.heard((n % 250, n // 250), n + 1)
    assert len(lease._heard_ns) <= REMEMBERED
    assert lease.holder(EXPIRES_NS) == MAVSDK


class TwoStations(RuleBasedStateMachine):
    """Stations come, command and fall silent in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.lease, self.t_ns = Lease(), 0
        self.heard: dict[tuple[int, int], int] = {}
        self.led: tuple[int, int] | None = None

    @rule(sender=st.sampled_from([QGC, MAVSDK, MAVPROXY]))
    def beats(self, sender: tuple[int, int]) -> None:
        self.lease.heard(sender, self.t_ns)
        self.heard[sender] = self.t_ns

    @rule(sender=st.sampled_from([QGC, MAVSDK, MAVPROXY]))
    def commands(self, sender: tuple[int, int]) -> None:
        alone = self.led is None or self.t_ns - self.heard[self.led] > EXPIRES_NS
        allowed = self.lease.take(sender, self.t_ns)
        assert allowed is (not self.lease.ground_leads and (alone or sender == self.led))
        if self.lease.ground_leads:
            self.led = None
        elif allowed and alone:
            self.led, self.heard[sender] = sender, self.t_ns

    @rule(seconds=st.integers(1, 15))
    def time_goes_on(self, seconds: int) -> None:
        self.t_ns += seconds * NS

    @rule(there=st.booleans())
    def our_ground_station(self, there: bool) -> None:
        self.lease.ground_leads = there

    @invariant()
    def anybody_may_land_it(self) -> None:
        assert all(self.lease.may(s, Action.LAND, Action.RETURN, self.t_ns) for s in (QGC, MAVSDK, MAVPROXY))


TestTwoStations = TwoStations.TestCase
