"""An independent plant: PyBullet's dynamics follow exported trajectories."""
