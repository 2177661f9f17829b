"""The closed loop of dispatcher, planner and cell: plans are cut and extended while robots work (`twin operate`)."""
