"""The bridge into MuJoCo: its structs by name, and a C callback that runs our compiled layer inside its step."""
