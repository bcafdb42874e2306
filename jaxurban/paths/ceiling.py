"""The height that drones fly no higher than, where nothing else is said, in whole metres."""

# Above the ground: the most in the open category of the EU (2019/947, UAS.OPEN.010), and 1.9 m less than 400 ft (14 CFR
# 107.51).
CEILING_M = 120
