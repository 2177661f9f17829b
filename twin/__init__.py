"""The digital twin: scenarios, execution, recordings and what a user touches."""
