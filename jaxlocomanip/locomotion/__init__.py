"""One quadruped's own control: gait, footholds, force MPC with the push as state, joint commands."""
