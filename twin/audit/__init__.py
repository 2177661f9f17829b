"""The independent witness: what was executed, measured again with PyBullet."""
