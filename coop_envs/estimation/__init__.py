"""The team's belief: who is where, how sure, who stands still, who is stuck or lost."""
