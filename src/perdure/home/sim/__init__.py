"""The simulation: robot, objects, apartments, scenes, sensors."""
