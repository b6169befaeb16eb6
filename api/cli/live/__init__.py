"""What `multicap live` makes of people while they are captured: lines of JSON, kept keypoints, VMC, the terminal."""
