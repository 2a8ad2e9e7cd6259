"""Material point method for soft bodies: finger with its spine, tactile gel; CPU and CUDA from one source."""
