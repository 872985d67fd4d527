"""The MAVLink faces of a vehicle.

`face` puts together what one link sees: `telemetry` out, `commands` in, `mission_service`, `parameters`; `craft` is
what all faces share. Our own ground station sees a face of fixed form, everybody else one in the mission's dialect.
"""
