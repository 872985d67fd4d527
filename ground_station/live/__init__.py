"""The live page of a mission, its feed, and the same for programs: `from ground_station.live.client import connect`."""
