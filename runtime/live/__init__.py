"""Labels while a ROS 2 system runs, over DDS."""
