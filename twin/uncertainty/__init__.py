"""What is drawn before a run begins: how long nodes take, and what goes wrong."""
