"""The whole system in a quarter of an hour, on the embedded garage, with the weights that come with the package.

    python tools/tour.py [--out output/tour] [--weights weights/cp_small.pth] [--train_minutes 2] [--episodes 3]

Makes a small data set, tests the network on garages that it never saw, measures bytes on the air, drives, trains a
little, and writes index.html with the pictures, videos and tables of all that: one file that can be sent around. Every
step is a command that you can run yourself; the page says which. What is done already is not done again.
"""

from pcdet_avp.commands.tour import run

if __name__ == "__main__":
    run()
