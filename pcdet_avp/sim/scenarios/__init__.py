"""Who stands and moves where: scenes to train on and the closed loop's scenarios."""
