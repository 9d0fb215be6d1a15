"""docs/robustness.md: PD, PID and impulses beside each other under disturbances."""
