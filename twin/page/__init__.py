"""Web page for people next to a cell with drivers: it shows the progress of the run, and has buttons for orders."""
