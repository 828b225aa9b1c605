"""A world without hardware: terrain, cars, a camera and scripted flights, deterministic by seed.

Everything is a value or a pure function of values and time: no clock, no global random numbers, no
window. `world` says what is where, `camera` what a camera sees of it, `flight` plays a whole sequence.

Frame of all positions: NED in metres (north, east, down), the ground plane at down = 0.
"""
