"""Who may make a vehicle fly when several ground stations see it: one leads, the others watch.

Our own ground station leads while it takes part in the clock. Otherwise whoever first commands something that flies
leads, until its heartbeat has been missing for a while or it lets go. Who watches may still make things safer (hold,
return, land), but never take back what is safer already: a return that somebody called for is not held by a watcher.
Who has paused a plan may let it go on, unless the leader has paused it too; until then the plans that our own ground
station sends are taken, but not flown: only a person at it who says so lets the vehicle go on.
"""

from __future__ import annotations

from vehicle.failsafe_table import Action

EXPIRES_NS = 10_000_000_000
Sender = tuple[int, int]
"""System and component id."""
OUR_GROUND: Sender = (-1, -1)
"""Our own ground station: anybody at a door may have its ids, but nobody these."""
SAFER = (Action.HOLD, Action.RETURN, Action.LAND)
REMEMBERED = 64
"""Senders whose heartbeats are remembered; the one that was silent for longest is forgotten for a new one."""


class Lease:
    """The leader at the doors of one vehicle."""

    def __init__(self) -> None:
        self.ground_leads = False
        """Whether our own ground station is there."""
        self.leader_heard_ns: int | None = None
        """When whoever leads, or led last, was heard last; None when nobody ever led."""
        self._holder: Sender | None = None
        self._heard_ns: dict[Sender, int] = {}

    def heard(self, sender: Sender, t_ns: int) -> None:
        """A heartbeat has come."""
        self._heard_ns[sender] = t_ns
        if sender == self._holder:
            self.leader_heard_ns = t_ns
        if len(self._heard_ns) > REMEMBERED:
            others = [s for s in self._heard_ns if s != self._holder]
            del self._heard_ns[min(others, key=lambda s: (self._heard_ns[s], s))]

    def take(self, sender: Sender, t_ns: int) -> bool:
        """Whether this sender leads, or leads from now on since nobody did."""
        if self.ground_leads:
            self._holder = None
            return False
        if self.holder(t_ns) is None:
            self._holder = sender
            self._heard_ns[sender] = self.leader_heard_ns = t_ns
        return self._holder == sender

    def may(self, sender: Sender, wish: Action, doing: Action, t_ns: int) -> bool:
        """Whether this sender may hold, call home or land a vehicle that is doing something of the ladder."""
        if wish in SAFER and wish >= doing:
            return True
        return self.take(sender, t_ns)

    def may_set(self, sender: Sender, t_ns: int) -> bool:
        """Whether this sender may change parameters: it leads, or nobody does."""
        return not self.ground_leads and self.holder(t_ns) in (None, sender)

    def let_go(self, sender: Sender) -> None:
        """The leader hands over: whoever commands next leads."""
        if self._holder == sender:
            self._holder = None

    def holder(self, t_ns: int) -> Sender | None:
        """Who leads at the doors; None when nobody does any more."""
        if self._holder is not None and t_ns - self._heard_ns.get(self._holder, -EXPIRES_NS - 1) > EXPIRES_NS:
            self._holder = None
        return self._holder

    @property
    def holder_name(self) -> str:
        """For people."""
        if self.ground_leads:
            return "swarmscan's ground station"
        return "nobody" if self._holder is None else f"ground station {self._holder[0]}"
