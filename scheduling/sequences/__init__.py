"""Plans executed one after another: copies of a plan, and plans of products that differ."""
