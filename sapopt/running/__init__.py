"""What a run is: its controls, what a policy may know, and what is shown meanwhile."""
