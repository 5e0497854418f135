"""The rig as it is drawn: in meshcat, as pixels, as markers."""
