"""A real autopilot as the body of a vehicle: the vehicle process is its companion computer."""
