"""Runs as messages of ROS 2 in an MCAP file, for Foxglove and ``ros2 bag``.

Imports exports, drawing and runs.
"""
