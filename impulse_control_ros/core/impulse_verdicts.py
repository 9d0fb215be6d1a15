"""The verdicts of the supervision on an impulse: numbers in commands, names in messages."""

VERDICTS = ('', 'confirmed', 'absent', 'out_of_band', 'reversed', 'growing', 'stalled')
NO_VERDICT, CONFIRMED, ABSENT, OUT_OF_BAND, REVERSED, GROWING, STALLED = range(7)
