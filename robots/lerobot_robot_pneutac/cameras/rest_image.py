"""Old name of `tactile`, for one more version."""

from lerobot_robot_pneutac.cameras.tactile import capture_rest_image, compare_rest_images

__all__ = ["capture_rest_image", "compare_rest_images"]
