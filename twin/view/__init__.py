"""3-D page of a cell in the browser: scene, replay of a run, and editing (``twin view``)."""
