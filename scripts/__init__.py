"""Commands for those who change Mocapella; not part of the package."""
