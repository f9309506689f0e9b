"""The robots a team is made of: their MJCF models and the numbers the planner takes from them."""
