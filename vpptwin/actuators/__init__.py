"""From command to thrust: rate loop, allocation, governor, servo, motor and blade, each a pure function of arrays.

Everything broadcasts over simulations (leading axis N) and returns its new state; nothing is kept between calls.
"""
