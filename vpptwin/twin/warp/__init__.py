"""The same steps as text of Warp kernels: on a GPU, or on Warp's processor device."""
