"""Pictures and film of a run, made off screen from its frames; nothing here knows a simulation."""
