"""What the supervision says of an impulse, by number as in commands and by name as in messages."""

VERDICTS = ('', 'confirmed', 'absent', 'out_of_band', 'reversed', 'growing', 'stalled')
NO_VERDICT, CONFIRMED, ABSENT, OUT_OF_BAND, REVERSED, GROWING, STALLED = range(7)
