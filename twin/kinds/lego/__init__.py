"""LEGO assemblies: bricks of a stock that are put on a plate."""
