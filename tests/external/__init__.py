"""Tests against a real PX4 or ArduPilot that SWARMSCAN_SITL names (docs/external_autopilots.md)."""
