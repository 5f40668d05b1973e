//! The rows: one keyword each, with its kind, unit, use and meaning.

use super::Kind::{Float, Integer, Logical, Text, Time};
use super::Use::{Both, Read, Written};
use super::{Group, Keyword, keywords, row};

keywords! {
    /// The whole table, except for the keywords of a solution.
    GROUPS:
    "File":
    ORIGIN, Text, "", Written, "where the file was made";
    CREATOR, Text, "", Written, "program that wrote the file";
    SWCOMMIT, Text, "", Written, "commit the program was built from";
    CONFSHA, Text, "", Both, "SHA-256 of the flight's configuration";
    INSTSHA, Text, "", Both, "SHA-256 of the instrument's file";
    DATE, Time, "", Written, "when the file was written, UTC";
    FILENAME, Text, "", Written, "this file's name";
    EXTNAME, Text, "", Written, "name of this extension";
    SOLARNET, Float, "", Written, "SOLARNET: 1 in full, 0.5 in part";
    OBS_HDU, Integer, "", Written, "1 where an observation's pixels stand";
    CHECKSUM, Text, "", Both, "checksum of the HDU";
    DATASUM, Text, "", Both, "checksum of the data";
    LONGSTRN, Text, "", Written, "texts may go on in CONTINUE cards";

    "Time":
    TIMESYS, Text, "", Both, "time scale of every time here";
    DATEREF, Time, "", Written, "zero of times counted in seconds";
    MJDREF, Float, "d", Written, "DATEREF as Modified Julian Date";
    TIMEUNIT, Text, "", Written, "unit of times counted from MJDREF";
    TSTART, Float, "s", Written, "first time, since MJDREF";
    TSTOP, Float, "s", Written, "last time, since MJDREF";
    DATE_OBS = "DATE-OBS", Time, "", Both, "start of the exposure";
    MJD_OBS = "MJD-OBS", Float, "d", Both, "DATE-OBS as Modified Julian Date";
    DATE_BEG = "DATE-BEG", Time, "", Both, "start of the exposure";
    MJD_BEG = "MJD-BEG", Float, "d", Both, "DATE-BEG as Modified Julian Date";
    DATE_AVG = "DATE-AVG", Time, "", Both, "middle of the exposure";
    MJD_AVG = "MJD-AVG", Float, "d", Both, "DATE-AVG as Modified Julian Date";
    DATE_END = "DATE-END", Time, "", Both, "end of the exposure";
    MJD_END = "MJD-END", Float, "d", Written, "DATE-END as Modified Julian Date";
    EXPTIME, Float, "s", Both, "length of the exposure";
    XPOSURE, Float, "s", Both, "length of the exposure";
    MONOTIME, Float, "s", Both, "mid-exposure on the monotonic clock";
    UTCSTEP, Float, "s", Both, "step of UTC since the frame before, if any";
    CAMCLOCK, Integer, "ns", Both, "the camera's own clock at the frame";
    CLKSYNC, Logical, "", Written, "whether the clock was synchronised to UTC";
    CLKOFF, Float, "s", Written, "clock minus UTC, by the kernel";
    CLKERR, Float, "s", Written, "largest error of the clock, as stated";
    CLKSRC, Text, "", Written, "time service that steers the clock";
    FRAMENUM, Integer, "", Both, "number of the frame in its sequence";

    "Instrument":
    OBSRVTRY, Text, "", Both, "name of the instrument file";
    TELESCOP, Text, "", Written, "name of the instrument file";
    INSTRUME, Text, "", Both, "kind of camera; read where CAMERA is not";
    OBJECT, Text, "", Written, "what the telescope points at";
    WAVELNTH, Float, "nm", Written, "middle of the filter's band";
    WAVEUNIT, Text, "", Written, "unit of WAVELNTH";
    CLOCKANG, Float, "deg", Written, "clocking: from the zenith to plate +Y";
    PLATEDIR, Text, "", Written, "directions count at: telescope, sun-2013";
    ROLLANG, Float, "deg", Written, "roll about the boresight, right low";
    ROLLANSG, Float, "deg", Written, "1 sigma of ROLLANG";
    BORE_X = "BORE-X", Float, "mil", Written, "boresight on the plate";
    BORE_Y = "BORE-Y", Float, "mil", Written, "boresight on the plate";
    PLATEDST, Float, "mm", Written, "from the lens to the plate";

    "Camera":
    CAMERA, Text, "", Both, "name of the camera";
    GAIN, Float, "", Both, "analogue gain, camera's unit";
    PREAMP, Float, "", Both, "pre-amplifier gain, camera's unit";
    CAMTEMP, Float, "degC", Both, "temperature of the camera";
    CORNER_X = "CORNER-X", Integer, "pixel", Both, "column of the sensor at first pixel";
    CORNER_Y = "CORNER-Y", Integer, "pixel", Both, "row of the sensor at first pixel";
    BITDEPTH, Integer, "bit", Both, "depth of the pixels";
    SATURATE, Integer, "DN", Both, "value at which a pixel saturates";
    BTYPE, Text, "", Written, "quantity in the pixels";
    BUNIT, Text, "", Written, "unit of the pixels";

    "Place":
    LATITUDE, Float, "deg", Both, "geodetic latitude, WGS 84";
    LONGITUD, Float, "deg", Both, "longitude, east positive, WGS 84";
    HEIGHT, Float, "m", Both, "height above the ellipsoid, WGS 84";
    OBSGEO_X = "OBSGEO-X", Float, "m", Both, "geocentric position";
    OBSGEO_Y = "OBSGEO-Y", Float, "m", Both, "geocentric position";
    OBSGEO_Z = "OBSGEO-Z", Float, "m", Both, "geocentric position";
    OBSGEO_B = "OBSGEO-B", Float, "deg", Both, "geodetic latitude, IAU 1976";
    OBSGEO_L = "OBSGEO-L", Float, "deg", Both, "longitude, east positive";
    OBSGEO_H = "OBSGEO-H", Float, "m", Both, "height above the ellipsoid, IAU 1976";

    "Observer and Sun":
    DSUN_OBS, Float, "m", Written, "from the observer to the Sun's centre";
    HGLN_OBS, Float, "deg", Written, "observer's Stonyhurst longitude";
    HGLT_OBS, Float, "deg", Written, "observer's heliographic latitude, B0";
    CRLN_OBS, Float, "deg", Written, "observer's Carrington longitude, L0";
    CRLT_OBS, Float, "deg", Written, "observer's heliographic latitude, B0";
    RSUN_REF, Float, "m", Written, "radius of the Sun (IAU 2015, B3)";
    RSUN_OBS, Float, "arcsec", Written, "radius of the Sun for the observer";
    SOLAR_P0, Float, "deg", Written, "solar north from celestial north";
    NORTHANG, Float, "deg", Written, "solar north from zenith, clockwise";
    SUN_AZ = "SUN-AZ", Float, "deg", Written, "the Sun's azimuth, N through E";
    SUN_EL = "SUN-EL", Float, "deg", Written, "the Sun's elevation, no refraction";
    TARGETX, Float, "arcsec", Written, "target, to solar west";
    TARGETY, Float, "arcsec", Written, "target, to solar north";

    "World coordinates":
    WCSAXES, Integer, "", Written, "axes of the world coordinates";
    WCSNAME, Text, "", Written, "name of the world coordinates";
    CTYPE1, Text, "", Written, "longitude, to solar west";
    CTYPE2, Text, "", Written, "latitude, to solar north";
    CNAME1, Text, "", Written, "name of coordinate 1";
    CNAME2, Text, "", Written, "name of coordinate 2";
    CUNIT1, Text, "", Written, "unit of coordinate 1";
    CUNIT2, Text, "", Written, "unit of coordinate 2";
    CRPIX1, Float, "pixel", Written, "disc's centre, first pixel is 1";
    CRPIX2, Float, "pixel", Written, "disc's centre, first pixel is 1";
    CRVAL1, Float, "arcsec", Written, "longitude of the disc's centre";
    CRVAL2, Float, "arcsec", Written, "latitude of the disc's centre";
    CDELT1, Float, "arcsec", Written, "scale per pixel";
    CDELT2, Float, "arcsec", Written, "scale per pixel";
    PC1_1, Float, "", Written, "coordinate 1 along x, over the scale";
    PC1_2, Float, "", Written, "coordinate 1 along y, over the scale";
    PC2_1, Float, "", Written, "coordinate 2 along x, over the scale";
    PC2_2, Float, "", Written, "coordinate 2 along y, over the scale";
    LONPOLE, Float, "deg", Written, "native longitude of the pole";
    LATPOLE, Float, "deg", Written, "native latitude of the pole";
    CRDER1, Float, "arcsec", Written, "1 sigma of the disc's centre";
    CRDER2, Float, "arcsec", Written, "1 sigma of the disc's centre";
    CSYER1, Float, "arcsec", Written, "1 sigma at limb by clocking and roll";
    CSYER2, Float, "arcsec", Written, "1 sigma at limb by clocking and roll";
}

/// Keywords of other programs for the same facts; read if the keywords above are missing, never written.
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
