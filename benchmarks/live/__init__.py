"""Plans driven on robots that others simulate: franky-sim, libfranka's protocol over MuJoCo's physics."""
