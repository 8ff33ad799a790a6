//! The OpenAPI document, generated from the calls.

use utoipa::OpenApi;
use utoipa::openapi::path::{Operation, ParameterIn, PathItem};
use utoipa::openapi::{self, Content, Ref, RefOr, Response};

use super::downloads::Format;
use super::event_stream::{Happened, Lost};
use super::problem::{self, Problem};

/// A part of the document: what the calls themselves do not name.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "drivetwin",
        description = "Control of a bench of emulated drives. Errors are RFC 9457 problem documents. \
                       What changes something has `Content-Type: application/json`, also without a body."
    ),
    components(schemas(Problem, Format, Happened, Lost))
)]
struct Frame;

/// The document without calls.
pub(super) fn begin() -> openapi::OpenApi {
    Frame::openapi()
}

/// Adds to each call what is answered before it is reached, and where its parts are read.
pub(super) fn complete(mut document: openapi::OpenApi) -> openapi::OpenApi {
    for item in document.paths.paths.values_mut() {
        let PathItem { get, put, post, delete, .. } = item;
        for operation in [get, put, post, delete].into_iter().flatten() {
            let has_body = operation.request_body.is_some();
            let names_something = names_something(operation);
            refuse(
                operation,
                "403",
                "It comes from a web page, or might: the Host is no loopback address, the Origin is another one, or what changes something lacks `Content-Type: application/json`.",
            );
            refuse(operation, "422", "Something is asked for that cannot be.");
            refuse(operation, "503", "The bench is stopping, or there is no room for one more reader.");
            if names_something {
                refuse(operation, "404", "There is nothing of that name; the nearest is offered.");
            }
            if has_body || names_something {
                refuse(operation, "400", "A name is no UTF-8, or the body no JSON.");
            }
            for response in operation.responses.responses.values_mut() {
                if let RefOr::T(response) = response
                    && response.description.is_empty()
                {
                    response.description =
                        if response.content.is_empty() { "It is done." } else { "As it is now." }.into();
                }
            }
            if has_body {
                refuse(operation, "408", "The body took too long.");
                refuse(operation, "413", "The body is too long.");
            }
        }
    }
    document
}

/// Returns whether a part of the path is a name.
fn names_something(operation: &Operation) -> bool {
    operation.parameters.iter().flatten().any(
        |parameter| matches!(parameter, RefOr::T(parameter) if parameter.parameter_in == ParameterIn::Path),
    )
}

/// A status that bears a problem document; where the call says more about it, that holds.
fn refuse(operation: &mut Operation, status: &str, when: &str) {
    operation.responses.responses.entry(status.to_owned()).or_insert_with(|| {
        let mut response = Response::new(when);
        let problem = Content::new(Some(Ref::from_schema_name("Problem")));
        response.content.insert(problem::MEDIA_TYPE.to_owned(), problem.into());
        response.into()
    });
}

#[cfg(test)]
mod tests {
    use drivetwin_firmware::device::Duration;
    use drivetwin_sim::line::faults::{BAUDS, LONGEST_DELAY, LineFaults};
    use serde_json::{Value, json};

    fn document() -> Value {
        let (_, document) = super::super::calls().split_for_parts();
        serde_json::to_value(super::complete(document)).unwrap()
    }

    /// The calls of the document, each with its path and method.
    fn calls() -> Vec<(String, Value)> {
        let document = document();
        let paths = document["paths"].as_object().unwrap();
        let calls = paths.iter().flat_map(|(path, item)| {
            let methods = item.as_object().unwrap().iter();
            methods.map(move |(method, call)| (format!("{method} {path}"), call.clone()))
        });
        calls.collect()
    }

    #[test]
    fn every_call_is_there() {
        let mut names: Vec<String> = calls().into_iter().map(|(name, _)| name).collect();
        names.sort();
        let expected = [
            "delete /api/drives/{name}/faults/{fault}",
            "get /api/bench",
            "get /api/buses",
            "get /api/drives/{name}",
            "get /api/events",
            "get /api/trace",
            "post /api/drives/{name}/encoder",
            "post /api/drives/{name}/pins/{pin}/pulses",
            "post /api/drives/{name}/power",
            "post /api/time/advance",
            "put /api/buses/{name}/faults",
            "put /api/drives/{name}/faults/{fault}",
            "put /api/drives/{name}/pins/{pin}",
            "put /api/drives/{name}/registers/{register}",
            "put /api/time",
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn every_refusal_is_a_problem_document_and_every_call_tells_its_own() {
        for (name, call) in calls() {
            let responses = call["responses"].as_object().unwrap();
            let has = |status: &str| responses.contains_key(status);
            assert!(has("403") && has("422") && has("503"), "{name}");
            assert_eq!(has("404"), name.contains('{'), "{name}");
            assert_eq!(has("408") && has("413"), call.get("requestBody").is_some(), "{name}");
            for (status, response) in responses {
                assert_ne!(response["description"], "", "{name} {status}");
                let problem = &response["content"]["application/problem+json"]["schema"]["$ref"];
                assert_eq!(
                    problem == "#/components/schemas/Problem",
                    status.starts_with(['4', '5']),
                    "{name} {status}"
                );
            }
        }
    }
    /// The schema takes no constants, so it repeats the ranges.
    #[test]
    fn faults_have_the_ranges_of_the_line() {
        let document = document();
        let faults = document["components"]["schemas"]["Faults"]["properties"].as_object().unwrap();
        for (name, schema) in faults {
            let (least, most) = match name.as_str() {
                "mute" => continue,
                "delay_ms" => (0, LONGEST_DELAY / Duration::millis(1)),
                "baud" => (u64::from(*BAUDS.start()), u64::from(*BAUDS.end())),
                "exception_code" => (1, u64::from(u8::MAX)),
                _ => (0, 1),
            };
            assert_eq!((&schema["minimum"], &schema["maximum"]), (&json!(least), &json!(most)), "{name}");
        }
        let outside = |exception_code| LineFaults { exception_code, ..LineFaults::default() }.check();
        assert!(outside(0).is_err() && outside(1).is_ok());
    }
}
