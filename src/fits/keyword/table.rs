//! The rows: one keyword each, with its kind, unit, use and meaning.

use super::Group;
use super::Kind::{Float, Integer, Logical, Text, Time};
use super::Use::{Both, Read, Written};
use super::row;

/// The whole table.
pub const GROUPS: &[Group] = &[
    FILE,
    TIME,
    INSTRUMENT,
    CAMERA,
    PLACE,
    OBSERVER,
    COORDINATES,
    SOLUTION,
];

/// The file and who wrote it.
#[rustfmt::skip]
const FILE: Group = Group {
    title: "File",
    keywords: &[
        row("ORIGIN", Text, "", Written, "where the file was made"),
        row("CREATOR", Text, "", Written, "program that wrote the file"),
        row("SWCOMMIT", Text, "", Written, "commit the program was built from"),
        row("CONFSHA", Text, "", Both, "SHA-256 of the flight's configuration"),
        row("INSTSHA", Text, "", Both, "SHA-256 of the instrument's file"),
        row("DATE", Time, "", Written, "when the file was written, UTC"),
        row("FILENAME", Text, "", Written, "this file's name"),
        row("EXTNAME", Text, "", Written, "name of this extension"),
        row("SOLARNET", Float, "", Written, "SOLARNET: 1 in full, 0.5 in part"),
        row("OBS_HDU", Integer, "", Written, "1 where an observation's pixels stand"),
        row("CHECKSUM", Text, "", Both, "checksum of the HDU"),
        row("DATASUM", Text, "", Both, "checksum of the data"),
        row("LONGSTRN", Text, "", Written, "texts may go on in CONTINUE cards"),
    ],
};

/// When the frame was taken.
#[rustfmt::skip]
const TIME: Group = Group {
    title: "Time",
    keywords: &[
        row("TIMESYS", Text, "", Both, "time scale of every time here"),
        row("DATEREF", Time, "", Written, "zero of times counted in seconds"),
        row("MJDREF", Float, "d", Written, "DATEREF as Modified Julian Date"),
        row("TIMEUNIT", Text, "", Written, "unit of times counted from MJDREF"),
        row("TSTART", Float, "s", Written, "first time, since MJDREF"),
        row("TSTOP", Float, "s", Written, "last time, since MJDREF"),
        row("DATE-OBS", Time, "", Both, "start of the exposure"),
        row("MJD-OBS", Float, "d", Both, "DATE-OBS as Modified Julian Date"),
        row("DATE-BEG", Time, "", Both, "start of the exposure"),
        row("MJD-BEG", Float, "d", Both, "DATE-BEG as Modified Julian Date"),
        row("DATE-AVG", Time, "", Both, "middle of the exposure"),
        row("MJD-AVG", Float, "d", Both, "DATE-AVG as Modified Julian Date"),
        row("DATE-END", Time, "", Both, "end of the exposure"),
        row("MJD-END", Float, "d", Written, "DATE-END as Modified Julian Date"),
        row("EXPTIME", Float, "s", Both, "length of the exposure"),
        row("XPOSURE", Float, "s", Both, "length of the exposure"),
        row("MONOTIME", Float, "s", Both, "mid-exposure on the monotonic clock"),
        row("UTCSTEP", Float, "s", Both, "step of UTC since the frame before, if any"),
        row("CAMCLOCK", Integer, "ns", Both, "the camera's own clock at the frame"),
        row("CLKSYNC", Logical, "", Written, "whether the clock was held to UTC"),
        row("CLKOFF", Float, "s", Written, "clock ahead of UTC, as the kernel knew"),
        row("CLKERR", Float, "s", Written, "largest error of the clock, as stated"),
        row("CLKSRC", Text, "", Written, "time service that held the clock"),
        row("FRAMENUM", Integer, "", Both, "number of the frame in its sequence"),
    ],
};

/// What the frame was taken with, but for the camera.
#[rustfmt::skip]
const INSTRUMENT: Group = Group {
    title: "Instrument",
    keywords: &[
        row("OBSRVTRY", Text, "", Both, "name of the instrument file"),
        row("TELESCOP", Text, "", Written, "name of the instrument file"),
        row("INSTRUME", Text, "", Both, "kind of camera; read where CAMERA is not"),
        row("OBJECT", Text, "", Written, "what the telescope points at"),
        row("WAVELNTH", Float, "nm", Written, "middle of the filter's band"),
        row("WAVEUNIT", Text, "", Written, "unit of WAVELNTH"),
        row("CLOCKANG", Float, "deg", Written, "clocking: from the zenith to plate +Y"),
        row("PLATEDIR", Text, "", Written, "directions count at: telescope, sun-2013"),
        row("ROLLANG", Float, "deg", Written, "roll about the boresight, right low"),
        row("ROLLANSG", Float, "deg", Written, "1 sigma of ROLLANG"),
        row("BORE-X", Float, "mil", Written, "boresight on the plate"),
        row("BORE-Y", Float, "mil", Written, "boresight on the plate"),
        row("PLATEDST", Float, "mm", Written, "from the lens to the plate"),
    ],
};

/// The camera and its pixels.
#[rustfmt::skip]
const CAMERA: Group = Group {
    title: "Camera",
    keywords: &[
        row("CAMERA", Text, "", Both, "name of the camera"),
        row("GAIN", Float, "", Both, "analogue gain, camera's unit"),
        row("PREAMP", Float, "", Both, "pre-amplifier gain, camera's unit"),
        row("CAMTEMP", Float, "degC", Both, "temperature of the camera"),
        row("CORNER-X", Integer, "pixel", Both, "column of the sensor at first pixel"),
        row("CORNER-Y", Integer, "pixel", Both, "row of the sensor at first pixel"),
        row("BITDEPTH", Integer, "bit", Both, "depth of the pixels"),
        row("SATURATE", Integer, "DN", Both, "value at which a pixel saturates"),
        row("BTYPE", Text, "", Written, "what the pixels tell"),
        row("BUNIT", Text, "", Written, "unit of the pixels: digital numbers"),
    ],
};

/// Where the frame was taken.
#[rustfmt::skip]
const PLACE: Group = Group {
    title: "Place",
    keywords: &[
        row("LATITUDE", Float, "deg", Both, "geodetic latitude, WGS 84"),
        row("LONGITUD", Float, "deg", Both, "longitude, east positive, WGS 84"),
        row("HEIGHT", Float, "m", Both, "height above the ellipsoid, WGS 84"),
        row("OBSGEO-X", Float, "m", Both, "geocentric position"),
        row("OBSGEO-Y", Float, "m", Both, "geocentric position"),
        row("OBSGEO-Z", Float, "m", Both, "geocentric position"),
        row("OBSGEO-B", Float, "deg", Both, "geodetic latitude, IAU 1976"),
        row("OBSGEO-L", Float, "deg", Both, "longitude, east positive"),
        row("OBSGEO-H", Float, "m", Both, "height above the ellipsoid, IAU 1976"),
    ],
};

/// The observer about the Sun, and the Sun in the observer's sky, at mid-exposure.
#[rustfmt::skip]
const OBSERVER: Group = Group {
    title: "Observer and Sun",
    keywords: &[
        row("DSUN_OBS", Float, "m", Written, "from the observer to the Sun's centre"),
        row("HGLN_OBS", Float, "deg", Written, "observer's Stonyhurst longitude"),
        row("HGLT_OBS", Float, "deg", Written, "observer's heliographic latitude, B0"),
        row("CRLN_OBS", Float, "deg", Written, "observer's Carrington longitude, L0"),
        row("CRLT_OBS", Float, "deg", Written, "observer's heliographic latitude, B0"),
        row("RSUN_REF", Float, "m", Written, "radius of the Sun (IAU 2015, B3)"),
        row("RSUN_OBS", Float, "arcsec", Written, "radius of the Sun for the observer"),
        row("SOLAR_P0", Float, "deg", Written, "solar north from celestial north"),
        row("NORTHANG", Float, "deg", Written, "solar north from zenith, clockwise"),
        row("SUN-AZ", Float, "deg", Written, "the Sun's azimuth, N through E"),
        row("SUN-EL", Float, "deg", Written, "the Sun's elevation, no refraction"),
        row("TARGETX", Float, "arcsec", Written, "target, to solar west"),
        row("TARGETY", Float, "arcsec", Written, "target, to solar north"),
    ],
};

/// The world coordinates of the pixels, where the frame shows a Sun.
#[rustfmt::skip]
const COORDINATES: Group = Group {
    title: "World coordinates",
    keywords: &[
        row("WCSAXES", Integer, "", Written, "axes of the world coordinates"),
        row("WCSNAME", Text, "", Written, "name of the world coordinates"),
        row("CTYPE1", Text, "", Written, "longitude, to solar west"),
        row("CTYPE2", Text, "", Written, "latitude, to solar north"),
        row("CNAME1", Text, "", Written, "name of coordinate 1"),
        row("CNAME2", Text, "", Written, "name of coordinate 2"),
        row("CUNIT1", Text, "", Written, "unit of coordinate 1"),
        row("CUNIT2", Text, "", Written, "unit of coordinate 2"),
        row("CRPIX1", Float, "pixel", Written, "disc's centre, first pixel is 1"),
        row("CRPIX2", Float, "pixel", Written, "disc's centre, first pixel is 1"),
        row("CRVAL1", Float, "arcsec", Written, "longitude of the disc's centre"),
        row("CRVAL2", Float, "arcsec", Written, "latitude of the disc's centre"),
        row("CDELT1", Float, "arcsec", Written, "scale per pixel"),
        row("CDELT2", Float, "arcsec", Written, "scale per pixel"),
        row("PC1_1", Float, "", Written, "coordinate 1 along x, over the scale"),
        row("PC1_2", Float, "", Written, "coordinate 1 along y, over the scale"),
        row("PC2_1", Float, "", Written, "coordinate 2 along x, over the scale"),
        row("PC2_2", Float, "", Written, "coordinate 2 along y, over the scale"),
        row("LONPOLE", Float, "deg", Written, "native longitude of the pole"),
        row("LATPOLE", Float, "deg", Written, "native latitude of the pole"),
        row("CRDER1", Float, "arcsec", Written, "1 sigma of the disc's centre"),
        row("CRDER2", Float, "arcsec", Written, "1 sigma of the disc's centre"),
        row("CSYER1", Float, "arcsec", Written, "1 sigma at limb by clocking and roll"),
        row("CSYER2", Float, "arcsec", Written, "1 sigma at limb by clocking and roll"),
    ],
};

/// What the solver found.
#[rustfmt::skip]
const SOLUTION: Group = Group {
    title: "Solution",
    keywords: &[
        row("QUALITY", Text, "", Written, "fine, coarse or none"),
        row("REASON", Text, "", Written, "why the frame went no further"),
        row("REASONIS", Float, "", Written, "what REASON is about, as measured"),
        row("REASONLM", Float, "", Written, "the limit that REASONIS missed"),
        row("SUNPX-X", Float, "pixel", Written, "disc's centre, first pixel is 0"),
        row("SUNPX-Y", Float, "pixel", Written, "disc's centre, first pixel is 0"),
        row("SUNPX-SX", Float, "pixel", Written, "1 sigma of SUNPX-X"),
        row("SUNPX-SY", Float, "pixel", Written, "1 sigma of SUNPX-Y"),
        row("SUNPX-R", Float, "pixel", Written, "disc's radius at the mapping's scale"),
        row("SUNPX-SR", Float, "pixel", Written, "1 sigma of SUNPX-R"),
        row("SUNMIL-X", Float, "mil", Written, "disc's centre on the plate"),
        row("SUNMIL-Y", Float, "mil", Written, "disc's centre on the plate"),
        row("SUNMILSX", Float, "mil", Written, "1 sigma of SUNMIL-X"),
        row("SUNMILSY", Float, "mil", Written, "1 sigma of SUNMIL-Y"),
        row("NMARKS", Integer, "", Written, "marks that were read"),
        row("MAPKIND", Text, "", Written, "kind of mapping, or its origin"),
        row("MAPSCALE", Float, "mil/pixel", Written, "plate length per pixel"),
        row("MAPSCASG", Float, "mil/pixel", Written, "1 sigma of MAPSCALE"),
        row("MAPROT", Float, "deg", Written, "rotation from +x towards +y"),
        row("MAPROTSG", Float, "deg", Written, "1 sigma of MAPROT"),
        row("MAPRES", Float, "pixel", Written, "rms residual of the marks"),
        row("OFFSETAZ", Float, "deg", Written, "azimuth, pointing minus target"),
        row("OFFSETEL", Float, "deg", Written, "elevation, pointing minus target"),
        row("OFFSETXE", Float, "deg", Written, "true angle across, to larger azimuth"),
        row("OFFSETSG", Float, "deg", Written, "1 sigma per axis of true angle"),
        row("OFFSETCS", Float, "deg", Written, "the same, left by the calibration"),
        row("BODYROLL", Float, "deg", Written, "roll by the horizon, right low"),
        row("BODYRLSG", Float, "deg", Written, "1 sigma of BODYROLL"),
        row("MOONPX-X", Float, "pixel", Written, "Moon's centre, first pixel is 0"),
        row("MOONPX-Y", Float, "pixel", Written, "Moon's centre, first pixel is 0"),
        row("MOONPXSX", Float, "pixel", Written, "1 sigma of MOONPX-X"),
        row("MOONPXSY", Float, "pixel", Written, "1 sigma of MOONPX-Y"),
        row("MOONPX-R", Float, "pixel", Written, "Moon's radius, vertical half axis"),
        row("MOONPXSR", Float, "pixel", Written, "1 sigma of MOONPX-R"),
        row("MOONPHAS", Float, "deg", Written, "phase angle, 0 full, 180 new"),
        row("MOONLIMB", Float, "deg", Written, "middle of bright limb, +x towards +y"),
        row("MOONDIRX", Float, "", Written, "direction to the Moon, camera's right"),
        row("MOONDIRY", Float, "", Written, "direction to the Moon, camera's down"),
        row("MOONDIRZ", Float, "", Written, "direction to the Moon, forward"),
        row("MOONDIRS", Float, "deg", Written, "1 sigma of the direction per axis"),
        row("SOLVETIM", Float, "s", Written, "wall time of the solver"),
    ],
};

/// What others say in other words; read where the keywords above do not stand, never written.
pub const FOREIGN: &[Group] = &[HEROES, OTHERS];

#[rustfmt::skip]
const HEROES: Group = Group {
    title: "Files of the HEROES flight of 2013",
    keywords: &[
        row("RT_SEC", Integer, "s", Read, "start of the exposure, since 1970"),
        row("RT_NSEC", Integer, "ns", Read, "the rest of RT_SEC"),
        row("DATE_OBS", Text, "", Read, "the same by C's asctime, without RT_SEC"),
        row("MON_SEC", Integer, "s", Read, "start of exposure on the monotonic clock"),
        row("MON_NSEC", Integer, "ns", Read, "the rest of MON_SEC"),
        row("TEMPCCD", Float, "degC", Read, "temperature of the camera"),
        row("GAIN_ANA", Float, "", Read, "analogue gain, camera's unit"),
        row("GAIN_PRE", Float, "", Read, "pre-amplifier gain, camera's unit"),
        row("CTL_AZIM", Float, "deg", Read, "azimuth, pointing minus target"),
        row("CTL_ELEV", Float, "deg", Read, "elevation, pointing minus target"),
    ],
};

#[rustfmt::skip]
const OTHERS: Group = Group {
    title: "Files of other programs",
    keywords: &[
        row("TIME-OBS", Text, "", Read, "time of day of a DATE-OBS without one"),
        row("UTC-OBS", Text, "", Read, "the same"),
        row("UT", Text, "", Read, "the same"),
        row("JD", Float, "d", Read, "start of the exposure, Julian Date"),
        row("EXPOSURE", Float, "s", Read, "length of the exposure"),
        row("XORGSUBF", Integer, "pixel", Read, "column of the sensor at first pixel"),
        row("YORGSUBF", Integer, "pixel", Read, "row of the sensor at first pixel"),
        row("DETSEC", Text, "", Read, "section of the sensor, [x0:x1,y0:y1] from 1"),
        row("CCDSEC", Text, "", Read, "the same"),
        row("ROWORDER", Text, "", Read, "TOP-DOWN or BOTTOM-UP: what the first row is"),
        row("BLANK", Integer, "", Read, "what a whole number is without a value"),
    ],
};
