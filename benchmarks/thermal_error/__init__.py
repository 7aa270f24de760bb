"""An open benchmark of nonlinear thermal error: data, splits, scores, a leaderboard."""
