"""LEGO assemblies: bricks from a stock that robots place on a plate."""
