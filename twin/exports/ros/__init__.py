"""Export of runs as ROS 2 messages in an MCAP file, for Foxglove and ``ros2 bag``.

Imports exports, drawing and runs.
"""
