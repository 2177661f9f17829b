"""The closed loop: dispatcher, planner and cell at once; plans are cut and extended while robots work (`twin operate`)."""
