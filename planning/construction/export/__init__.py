"""From a plan in space-time to the motion plan that everything after it takes."""
