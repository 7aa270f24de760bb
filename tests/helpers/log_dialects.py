"""One log in the dialects of loggers, spreadsheets and people; hypothesis draws its samples."""

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

from hypothesis import strategies as st

BEGIN = datetime(2026, 3, 2, 6, 0, 0, 500_000, tzinfo=UTC)
DAYS = BEGIN.date().toordinal() - datetime(1899, 12, 30).toordinal()


def plain(samples):
    """The log in plain CSV: s since 1970."""
    rows = (f"{at.timestamp()!r},{t},{x},{n}\n" for at, t, x, n in samples)
    return "time_s,T1_degC,x_um,n_rpm\n" + "".join(rows)


def comma(number):
    return number.replace(".", ",")


def grouped(number, group, decimal):
    whole, _, part = number.partition(".")
    return f"{int(whole):,}".replace(",", group) + (decimal + part if part else "")


def german(samples, encoding):
    header = "Logger 7;12345\n\nDatum;Uhrzeit;Bemerkung;T1 [°C];x [µm];n [min-1]\n"
    rows = (
        f"{at:%d.%m.%Y};{at:%H:%M:%S},5;;{comma(t)};{grouped(x, '.', ',')};{n}\n"
        for at, t, x, n in samples
    )
    return (header + "".join(rows)).encode(encoding)


def with_units_below(samples, encoding):
    header = "sep=;\r\nZeit;T1;x;n\r\n[s];[°C];[μm];[1/min]\r\n"
    rows = (
        f"{comma(repr(at.timestamp()))};{comma(t)};{comma(x)};{n}\r\n" for at, t, x, n in samples
    )
    return (header + "".join(rows)).encode(encoding)


def american(samples, encoding):
    rows = (
        f"{at.month}/{at.day}/{at.year} {at:%I:%M:%S}.5 {at:%p}\t{t}\t"
        f'"{grouped(x, ",", ".")}"\t{n}\n'
        for at, t, x, n in samples
    )
    return ("timestamp\tT1/°C\tx/µm\tn / min-1\n" + "".join(rows)).encode(encoding)


def blanks(samples, encoding):
    rows = (f" {1e3 * at.timestamp():.0f}   {t} {x}  {n}\n" for at, t, x, n in samples)
    return ("# of a logger\n# timestamp T1_degC x_um n_rpm\n" + "".join(rows)).encode(encoding)


def zoned(samples, encoding):
    berlin = ZoneInfo("Europe/Berlin")
    rows = (
        f"{at.astimezone(berlin):%Y-%m-%d %H:%M:%S}.5 Europe/Berlin;{t};{x};{n};\n"
        for at, t, x, n in samples
    )
    return ("Zeitstempel;T1 in °C;x (µm);n_rpm;\n" + "".join(rows)).encode(encoding)


def spreadsheet(samples, encoding):
    rows = (
        f"{DAYS + (at - BEGIN.replace(hour=0, second=0, microsecond=0)) / timedelta(days=1)!r},"
        f"{t},{x},{n}\n"
        for at, t, x, n in samples
    )
    return ("Datum,T1 [degC],x [um],n [U/min]\n" + "".join(rows)).encode(encoding)


DIALECTS = [german, with_units_below, american, blanks, zoned, spreadsheet]


@st.composite
def logs(draw):
    count = draw(st.integers(3, 12))
    steps = draw(st.lists(st.integers(1, 4000), min_size=count, max_size=count))
    numbers = st.integers(-99_999, 9_999_999)
    at, samples = BEGIN, []
    for step in steps:
        at += timedelta(seconds=step)
        t = f"{draw(numbers) % 80_000 / 1e3:.3f}"
        x = f"{draw(numbers) % 9_000_000 / 1e4:.4f}"
        samples.append((at, t, x, str(draw(numbers) % 8000)))
    return samples
