"""Scenes to train on and the closed loop's scenarios: the road users in a garage and their motion."""
