"""The simulated world on the far side of the wires: scene, cameras, sensors, clock, referee. Imports missions only."""
