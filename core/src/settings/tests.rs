//! The table of settings against the types that hold them, and requests.

use super::*;
use serde_json::json;
use std::ops::Bound;

fn request(json: Value) -> IntegratorRequest {
    serde_json::from_value(json).unwrap()
}

fn wishes(integrator: Option<IntegratorSettings>) -> Wishes {
    Wishes {
        integrator,
        max_depth: Some(5),
        sample_count: None,
    }
}

#[test]
fn what_is_left_out_is_up_to_the_scene() {
    let own = IntegratorSettings::Pppm(PppmSettings {
        alpha: 0.3,
        samples: 7,
        max_depth: Some(5),
        ..PppmSettings::default()
    });
    let asked = request(json!({"type": "pppm", "samples": 2}));
    let IntegratorSettings::Pppm(found) = asked.resolve(&wishes(Some(own.clone()))).unwrap() else {
        panic!("another integrator")
    };
    assert_eq!((found.alpha, found.samples, found.max_depth), (0.3, 2, Some(5)));
    let IntegratorSettings::Pppm(found) = asked.resolve(&wishes(None)).unwrap() else {
        panic!("another integrator")
    };
    let default = PppmSettings::default();
    assert_eq!(
        (found.alpha, found.samples, found.max_depth),
        (default.alpha, 2, Some(5))
    );
    let path = request(json!({"type": "path"})).resolve(&wishes(Some(own))).unwrap();
    assert!(matches!(path, IntegratorSettings::Path(path) if path.max_depth == Some(5)));
}

#[test]
fn what_is_given_stays() {
    let given = request(json!({"type": "path", "samples": 3, "sampling": "independent", "max_depth": null}));
    let settings = given.complete().unwrap();
    assert_eq!(
        given.resolve(&wishes(None)).unwrap(),
        *settings,
        "no limit is a limit that is given"
    );
    assert_eq!(IntegratorRequest::from(settings.clone()), given);
    let text = serde_json::to_string(&request(json!({"type": "pcf", "alpha": 0.2, "theta1": 1e-3}))).unwrap();
    assert_eq!(text, r#"{"alpha":0.2,"theta1":0.001,"type":"pcf"}"#);
    assert!(given.resolve(&Wishes::default()).is_ok());
    let bad = request(json!({"type": "path", "samples": 0}));
    assert_eq!(bad.resolve(&wishes(None)).unwrap_err().name, "samples");
}

#[test]
fn a_request_survives_its_json_and_says_what_it_allows() {
    let text = json!({"type": "pcf", "alpha": 0.25, "samplers": ["camera"]});
    let asked = request(text.clone());
    assert_eq!(serde_json::to_value(&asked).unwrap(), text);
    assert_eq!(asked.complete(), None);
    let resolved = asked.resolve(&wishes(None)).unwrap();
    assert!(asked.allows(&resolved) && !asked.allows(&IntegratorSettings::Pcf(PcfSettings::default())));
    assert!(!asked.allows(&IntegratorSettings::Path(PathSettings::default())));
    for (bad, said) in [
        (r#"{"type": "pcf", "photon": 1}"#, "photon"),
        (r#"{"type": "pcf", "alpha": 0.1, "alpha": 0.2}"#, "duplicate"),
        (r#"{"type": "erpt"}"#, "erpt"),
        (r#"{"alpha": 0.1}"#, "type"),
        (r#"["pcf"]"#, "sequence"),
    ] {
        let error = serde_json::from_str::<IntegratorRequest>(bad).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    }
}

/// Values at each end of the range, and values just beyond.
fn ends(kind: &Kind) -> (Vec<Value>, Vec<Value>) {
    let numbers = |range: &Range| {
        let least = match range.0 {
            Bound::Included(end) => (end, end.next_down()),
            Bound::Excluded(end) => (end.next_up(), end),
            Bound::Unbounded => panic!("a setting without a lower end"),
        };
        let most = match range.1 {
            Bound::Included(end) => (end, json!(end.next_up())),
            Bound::Excluded(end) => (end.next_down(), json!(end)),
            Bound::Unbounded => (f32::MAX, json!(1e39)),
        };
        (
            vec![json!(least.0), json!(most.0)],
            vec![json!(least.1), most.1, json!("one")],
        )
    };
    match kind {
        Kind::Integer { least, most } => (
            vec![json!(least), json!(most)],
            vec![
                json!(i64::from(*least) - 1),
                json!(u64::from(*most) + 1),
                json!(1.5),
                json!("two"),
            ],
        ),
        Kind::Number(range) => numbers(range),
        Kind::Truth => (vec![json!(true), json!(false)], vec![json!(1), json!("true")]),
        Kind::Choice(words) => (
            words.iter().map(|word| json!(word)).collect(),
            vec![json!("other"), json!(0)],
        ),
        Kind::Choices { words, needed } => (
            match needed {
                [] => words.iter().map(|word| json!([word])).chain([json!(words)]).collect(),
                _ => needed.iter().map(|word| json!([word])).chain([json!(words)]).collect(),
            },
            {
                let unneeded = words.iter().filter(|word| !needed.is_empty() && !needed.contains(word));
                let alone = unneeded.map(|word| json!([word]));
                let others = [
                    json!([]),
                    json!(["other"]),
                    json!([words[0], words[0]]),
                    json!(words[0]),
                ];
                alone.chain(others).collect()
            },
        ),
        Kind::Numbers { range, most } => {
            let (valid, invalid) = numbers(range);
            let longest = json!(vec![valid[1].clone(); *most]);
            let too_long = json!(vec![valid[1].clone(); most + 1]);
            let valid = valid
                .into_iter()
                .map(|number| json!([number]))
                .chain([json!([]), longest]);
            let invalid = invalid
                .into_iter()
                .map(|number| json!([number]))
                .chain([too_long, json!(1)]);
            (valid.collect(), invalid.collect())
        }
    }
}

#[test]
fn the_table_and_the_type_name_the_same_settings() {
    for integrator in INTEGRATORS {
        let defaults = integrator.defaults();
        assert_eq!(defaults.name(), integrator.name);
        assert_eq!(Integrator::find(integrator.name), Some(integrator));
        let fields = fields_of(&defaults);
        let mut held: Vec<&str> = fields
            .keys()
            .map(String::as_str)
            .filter(|name| *name != "type")
            .collect();
        let mut named: Vec<&str> = integrator.settings.iter().map(|setting| setting.name).collect();
        held.sort_unstable();
        named.sort_unstable();
        assert_eq!(held, named, "{}", integrator.name);
        assert!(integrator.setting("max_depth").is_some(), "{}", integrator.name);
    }
    assert_eq!(Integrator::find("magic"), None);
}

#[test]
fn values_at_the_ends_are_accepted_and_those_beyond_are_refused() {
    for integrator in INTEGRATORS {
        for setting in integrator.settings {
            let given = |value: &Value| Map::from_iter([(setting.name.to_owned(), value.clone())]);
            let (mut valid, invalid) = ends(&setting.kind);
            match setting.instead {
                Some(Instead::Null(words)) => {
                    valid.push(Value::Null);
                    words
                        .iter()
                        .for_each(|word| assert_eq!(setting.parse(word), Ok(Value::Null)));
                }
                Some(Instead::Word(word)) => valid.push(json!(word)),
                None => assert!(setting.check(&Value::Null).is_err(), "{}", setting.name),
            }
            for value in valid {
                let settings = integrator.read(given(&value)).unwrap();
                assert_eq!(settings.validate(), Ok(()), "{value}");
                let kept = &fields_of(&settings)[setting.name];
                let mut short = value.clone();
                shorten(&mut short);
                assert_eq!(*kept, short, "{} keeps {value}", setting.name);
                assert_eq!(
                    setting.parse(&setting.text(kept)),
                    Ok(short),
                    "{} reads {value}",
                    setting.name
                );
            }
            for value in invalid {
                let error = integrator.read(given(&value)).unwrap_err();
                assert_eq!(error.name, setting.name, "{error}");
                let mut asked = given(&value);
                asked.insert("type".to_owned(), integrator.name.into());
                match serde_json::from_value::<IntegratorRequest>(Value::Object(asked)) {
                    Ok(request) => assert_eq!(request.with_defaults().validate().unwrap_err().name, setting.name),
                    Err(error) => assert!(error.to_string().contains(setting.name), "{error}"),
                }
            }
        }
    }
}

#[test]
fn errors_say_what_is_expected() {
    let errors = [
        (
            "alpha",
            "1.5",
            "setting `alpha` is 1.5: expected a number between 0 and 1, both excluded",
        ),
        (
            "sigma1",
            "0",
            "setting `sigma1` is 0: expected a number above 0 [scene units], or `auto` (null in JSON)",
        ),
        (
            "samples",
            "many",
            "setting `samples` is many: expected a whole number from 1 to 65536",
        ),
        (
            "max_depth",
            "0",
            "setting `max_depth` is 0: expected a whole number from 1 on, or `none` (null in JSON)",
        ),
        (
            "lookup_vertex",
            "65",
            "setting `lookup_vertex` is 65: expected a whole number from 1 to 64, or `auto`",
        ),
        (
            "theta1",
            "NaN",
            "setting `theta1` is NaN: expected a number from 0.1 to 180 [degrees]",
        ),
        ("nested", "1", "setting `nested` is 1: expected true or false"),
        (
            "kernel",
            "sinc",
            "setting `kernel` is sinc: expected box or epanechnikov",
        ),
        (
            "samplers",
            "bsdf moon",
            "setting `samplers` is bsdf moon: expected a list of one or more of bsdf, camera, importon, each once",
        ),
        (
            "sigma_by_length",
            "0.5,2",
            "setting `sigma_by_length` is 0.5,2: expected a list of up to 64 numbers above 0, up to 1",
        ),
    ];
    let pcf = Integrator::find("pcf").unwrap();
    for (name, text, expected) in errors {
        let error = pcf.setting(name).unwrap().parse(text).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
    let infinite = IntegratorSettings::Pppm(PppmSettings {
        sigma1: Some(f32::INFINITY),
        ..PppmSettings::default()
    });
    assert_eq!(infinite.validate().unwrap_err().name, "sigma1");
}

#[test]
fn the_reference_has_every_setting_once_with_its_defaults() {
    let entries = reference();
    let entry = |name: &str| entries.iter().find(|entry| entry.setting.name == name).unwrap();
    assert_eq!(
        entry("samples").default(),
        "4 (path, pcf), 1 (light, bdpt, vcm, pppm, sppm, surfaces)"
    );
    assert_eq!(entry("sigma1").integrators(), "vcm, pppm, sppm, pcf");
    assert_eq!(entry("max_depth").default(), "none");
    assert_eq!(entry("samplers").default(), "bsdf,camera");
    assert_eq!(entry("sigma_by_length").default(), "empty");
}
