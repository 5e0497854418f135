"""What the drone on its rail rig may have: generic laws of `vpptwin.effects` with its numbers, and some of its own."""
