"""Geometry of the robot and its surroundings: transforms, descriptions, footprints, costs, clouds and scans."""
