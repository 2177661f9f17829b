"""Goals: robots go to configurations and poses, and nothing is built."""
