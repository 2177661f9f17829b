"""Planning of scenarios: building the workcell, and all stages from assignment to the temporal plan graph."""
