"""Weights fitted to demonstrations or to targets."""
