"""ROS 1 and ROS 2 bags: streams, cameras and mounts of their messages."""
