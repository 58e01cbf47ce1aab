"""The depth camera: rays cast at a scene, clipped, encoded."""
