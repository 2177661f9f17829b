"""What a robot is to a session, the drivers that there are, and the file that names them."""
