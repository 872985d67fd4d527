"""The live page of a mission, its feed, and the same for programs: `from ground_station import connect`."""
