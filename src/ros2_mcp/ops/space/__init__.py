"""The robot in space: coordinate frames, transforms, joints, sensors and the scene."""
