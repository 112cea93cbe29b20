//! Where the sun stands, by place and time: the PSA algorithm (Blanco-Muriel, Alarcon-Padilla, Lopez-Moratalla and Lara-Coira 2001,
//! "Computing the Solar Vector", Solar Energy 70 (5)), which is right to half an arc minute for the years 1999 to 2015, and to a few
//! in this century.

use glam::DVec3;

/// A place on Earth and a time there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// North of the equator \[degrees\].
    pub latitude: f64,
    /// East of Greenwich \[degrees\].
    pub longitude: f64,
    /// What local time is ahead of Universal Time \[hours\].
    pub timezone: f64,
    /// Gregorian year, month from 1 and day from 1.
    pub date: [i64; 3],
    /// Local time: hour, minute and second, each with any fraction.
    pub time: [f64; 3],
}

/// Mean radius of the Earth over its distance from the sun.
const PARALLAX: f64 = 6371.01 / 149_597_890.0;

/// Unit direction to the sun: x to the south, y to the west, z up. It may lie below the horizon.
#[must_use]
pub fn sun_direction(moment: &Moment) -> DVec3 {
    let [hour, minute, second] = moment.time;
    let universal_hours = hour - moment.timezone + (minute + second / 60.0) / 60.0;
    let days = days_since_2000(moment.date) as f64 - 0.5 + universal_hours / 24.0;

    // Ecliptic coordinates, equations 3 to 8.
    let omega = 2.1429 - 0.001_039_459_4 * days;
    let mean_longitude = 4.895_063 + 0.017_202_791_698 * days;
    let anomaly = 6.240_06 + 0.017_201_969_9 * days;
    let longitude = mean_longitude + 0.033_416_07 * libm::sin(anomaly) + 0.000_348_94 * libm::sin(2.0 * anomaly)
        - 0.000_113_4
        - 0.000_020_3 * libm::sin(omega);
    let obliquity = 0.409_092_8 - 6.214e-9 * days + 0.000_039_6 * libm::cos(omega);

    // Celestial coordinates, equations 9 and 10.
    let right_ascension = libm::atan2(libm::cos(obliquity) * libm::sin(longitude), libm::cos(longitude));
    let declination = libm::asin(libm::sin(obliquity) * libm::sin(longitude));

    // Local coordinates, equations 11 to 16.
    let greenwich_hours = 6.697_424_324_2 + 0.065_709_828_3 * days + universal_hours;
    let local_angle = (greenwich_hours * 15.0 + moment.longitude).to_radians();
    let hour_angle = local_angle - right_ascension;
    let latitude = moment.latitude.to_radians();
    let (sin_latitude, cos_latitude) = libm::sincos(latitude);
    let cos_zenith =
        cos_latitude * libm::cos(hour_angle) * libm::cos(declination) + libm::sin(declination) * sin_latitude;
    let geocentric = libm::acos(cos_zenith.clamp(-1.0, 1.0));
    let azimuth = libm::atan2(
        -libm::sin(hour_angle),
        libm::tan(declination) * cos_latitude - sin_latitude * libm::cos(hour_angle),
    );
    let zenith = geocentric + PARALLAX * libm::sin(geocentric);
    let (sin_azimuth, cos_azimuth) = libm::sincos(azimuth);
    let (sin_zenith, cos_zenith) = libm::sincos(zenith);
    // Azimuths go from the north to the east.
    DVec3::new(-sin_zenith * cos_azimuth, -sin_zenith * sin_azimuth, cos_zenith)
}

/// Days from noon of 1 January 2000 to noon of the date, equation 2; divisions are those of integers, towards zero.
fn days_since_2000([year, month, day]: [i64; 3]) -> i64 {
    let january = (month - 14) / 12;
    (1461 * (year + 4800 + january)) / 4 + (367 * (month - 2 - 12 * january)) / 12
        - (3 * ((year + 4900 + january) / 100)) / 4
        + day
        - 32_075
        - 2_451_545
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        assert_eq!(days_since_2000([2000, 1, 1]), 0);
        assert_eq!(days_since_2000([2000, 3, 1]), 60, "a leap year");
        assert_eq!(days_since_2000([2001, 1, 1]), 366);
        assert_eq!(days_since_2000([1999, 12, 31]), -1);
        assert_eq!(
            days_since_2000([2100, 3, 1]) - days_since_2000([2100, 2, 28]),
            1,
            "no leap year"
        );
    }

    /// The expected directions are those of another method, the Astronomical Almanac's for low precision, which is right to 0.01
    /// degrees. (Mitsuba 3.9.1 counts days in single precision, where a quarter of a day is lost.)
    #[test]
    fn the_sun_stands_where_the_almanac_has_it() {
        let tokyo = Moment {
            latitude: 35.6894,
            longitude: 139.6917,
            timezone: 9.0,
            date: [2010, 7, 10],
            time: [15.0, 0.0, 0.0],
        };
        let london = Moment {
            latitude: 51.5,
            longitude: -0.12,
            timezone: 1.0,
            date: [2024, 3, 20],
            time: [9.0, 30.0, 15.0],
        };
        let sydney = Moment {
            latitude: -33.9,
            longitude: 151.2,
            timezone: 11.0,
            date: [2030, 12, 1],
            time: [17.0, 0.0, 0.0],
        };
        for (moment, expected) in [
            (tokyo, DVec3::new(0.051_37, 0.691_73, 0.720_32)),
            (london, DVec3::new(0.454_61, -0.813_08, 0.363_63)),
            (sydney, DVec3::new(0.081_07, 0.834_26, 0.545_38)),
        ] {
            let direction = sun_direction(&moment);
            let angle = libm::acos(direction.dot(expected.normalize()).min(1.0)).to_degrees();
            assert!(angle < 0.03, "{moment:?}: {direction}, {angle} degrees from {expected}");
        }
    }
}
