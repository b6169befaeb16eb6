"""Forces without plates: of the whole body, of each foot, and moments and powers of joints."""
