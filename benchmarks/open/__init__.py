"""The open benchmark: plans of any planner for the same tasks, judged by the same judge."""
