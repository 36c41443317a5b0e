"""Campaigns: thousands of simulated missions, their table and their report."""
