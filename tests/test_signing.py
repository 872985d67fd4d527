"""MAVLink 2 signing: who is heard, who is refused and counted, and that nobody can be locked out."""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from missions.errors import UserError
from missions.mavlink import Endpoint
from missions.signing import PER_SECOND, WINDOW_S, Signing, read_key

KEY, OTHER = hashlib.sha256(b"a").digest(), hashlib.sha256(b"b").digest()
NOON = 375_000_000 * PER_SECOND


class Clock:
    """A clock that tests set."""

    def __init__(self, now: int = NOON) -> None:
        self.now = now

    def __call__(self) -> int:
        return self.now


def signing(key: bytes = KEY, now: int = NOON, link_id: int = 0) -> Signing:
    return Signing(key, link_id, Clock(now))


def heartbeat() -> Any:
    return mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def pymavlink_end(key: bytes, now: int) -> mav.MAVLink:
    end = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    end.robust_parsing = True
    end.signing.secret_key, end.signing.sign_outgoing, end.signing.timestamp = key, True, now
    return end


def test_what_pymavlink_signs_is_accepted_and_the_other_way_round() -> None:
    theirs, ours = pymavlink_end(KEY, NOON), Endpoint(1, 1, signing())
    for _ in range(3):
        assert [m.get_type() for m in ours.parse([heartbeat().pack(theirs)])] == ["HEARTBEAT"]
    back = pymavlink_end(KEY, NOON)
    for _ in range(3):
        message = back.parse_char(ours.pack(mav.MAVLink_mission_count_message(255, 190, 7)))
        assert (message.get_type(), message.get_signed(), message.count) == ("MISSION_COUNT", True, 7)
    assert ours.rejected == 0


@given(st.integers(0, 8 * 34 - 1))
def test_no_flipped_bit_gets_through(bit: int) -> None:
    frame = bytearray(Endpoint(255, 190, signing()).pack(heartbeat()))
    assert len(frame) == 10 + 9 + 2 + 13
    frame[bit // 8] ^= 1 << bit % 8
    judge = signing()
    assert not judge.accepts(bytes(frame))
    assert Endpoint(1, 1, signing()).parse([bytes(frame)]) == []


def test_unsigned_wrong_key_mavlink_1_and_replay_are_refused_and_counted() -> None:
    judge = signing()
    end, sender = Endpoint(1, 1, judge), Endpoint(255, 190, signing())
    first, second = sender.pack(heartbeat()), sender.pack(heartbeat())
    old = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    assert len(end.parse([first, second])) == 2
    assert end.parse([first, second, Endpoint(255, 190).pack(heartbeat()), heartbeat().pack(old, force_mavlink1=True),
                      Endpoint(255, 190, signing(OTHER)).pack(heartbeat())]) == []
    assert dict(judge.refused) == {"replayed": 2, "unsigned": 2, "wrong signature": 1}
    assert end.rejected == 5
    assert len(end.parse([sender.pack(heartbeat())])) == 1


def test_a_forgery_from_the_far_future_locks_nobody_out() -> None:
    judge = signing()
    end = Endpoint(1, 1, judge)
    honest = Endpoint(255, 190, signing())
    year = 365 * 86400 * PER_SECOND
    for key in (KEY, OTHER):
        assert end.parse([Endpoint(255, 190, signing(key, NOON + year)).pack(heartbeat())]) == []
    assert len(end.parse([honest.pack(heartbeat())])) == 1
    assert dict(judge.refused) == {"out of time": 1, "wrong signature": 1}
    assert int.from_bytes(end.pack(heartbeat())[-12:-6], "little") == NOON


@pytest.mark.parametrize(("late_s", "told"), [(0.0, None), (WINDOW_S, None), (WINDOW_S + 1, "out of time"),
                                              (-WINDOW_S, None), (-WINDOW_S - 1, "out of time")])
def test_how_far_clocks_may_differ(late_s: float, told: str | None) -> None:
    clock = Clock(NOON - 1000 * PER_SECOND)
    judge = Signing(KEY, 0, clock)
    clock.now = NOON + round(late_s * PER_SECOND)
    assert judge.accepts(Endpoint(255, 190, signing()).pack(heartbeat())) == (told is None)
    assert list(judge.refused) == ([] if told is None else [told])


def test_what_was_recorded_before_a_restart_is_refused_after_it() -> None:
    recorded = Endpoint(255, 190, signing(now=NOON - 5 * PER_SECOND)).pack(heartbeat())
    assert signing(now=NOON - 20 * PER_SECOND).accepts(recorded)
    restarted = signing()
    assert not restarted.accepts(recorded)
    assert restarted.accepts(Endpoint(255, 190, signing()).pack(heartbeat()))


def test_links_and_components_have_streams_of_their_own() -> None:
    judge = signing()
    ahead = Endpoint(255, 190, signing(now=NOON + 30 * PER_SECOND))
    assert judge.accepts(ahead.pack(heartbeat()))
    for other in (Endpoint(255, 190, signing(link_id=1)), Endpoint(255, 191, signing()), Endpoint(254, 190, signing())):
        assert judge.accepts(other.pack(heartbeat()))
    assert not judge.accepts(Endpoint(255, 190, signing()).pack(heartbeat()))


def test_timestamps_rise_even_when_the_clock_stands_or_goes_back() -> None:
    clock = Clock()
    end, judge = Endpoint(255, 190, Signing(KEY, 0, clock)), signing()
    for step in (0, 0, -100, 5):
        clock.now += step
        assert judge.accepts(end.pack(heartbeat()))


@given(st.binary(max_size=300))
def test_noise_is_refused(noise: bytes) -> None:
    assert not signing().accepts(noise)


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_key_is_read_and_never_shown(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = written(tmp_path / "key", KEY.hex() + "\n")
    with caplog.at_level(logging.DEBUG):
        key = read_key(path)
        end = Endpoint(1, 1, Signing(key))
        end.parse([Endpoint(255, 190, Signing(OTHER)).pack(heartbeat())])
    assert key == KEY
    assert KEY.hex() not in caplog.text + repr(vars(end)) + repr(Signing(key))


@pytest.mark.parametrize(("text", "mode", "told"), [
    (KEY.hex(), 0o640, "others than its owner may use the signing key; run 'chmod 600"),
    (KEY.hex(), 0o604, "others than its owner"),
    (KEY.hex()[:-2], 0o600, "must hold 64 hexadecimal digits"),
    ("secret passphrase", 0o600, "must hold 64 hexadecimal digits"),
    ("\u00e9" * 32, 0o600, "must hold 64 hexadecimal digits")])
def test_a_bad_key_file_is_refused_without_telling_it(tmp_path: Path, text: str, mode: int, told: str) -> None:
    path = written(tmp_path / "key", text, mode)
    with pytest.raises(UserError, match=told) as refused:
        read_key(path)
    assert text not in str(refused.value)


def test_a_missing_key_file_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"openssl rand -hex 32 >") as refused:
        read_key(tmp_path / "none")
    assert os.strerror(2) in str(refused.value)
