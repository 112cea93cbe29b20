//! What URLs are to be told is kept with the end of the job, until somebody was told or it is forgotten.

use super::tests::{Kept, head, stores};
use super::*;
use photonfarm_proto::job::JobState;
use photonfarm_test_servers::Postgres;

fn notice(id: &str, job: u64, trusted: bool, created_ms: Millis) -> Notice {
    Notice {
        id: id.into(),
        job: JobId(job),
        url: format!("http://example.org/{id}?"),
        trusted,
        body: format!("{{\"delivery\":\"{id}\"}}"),
        created_ms,
    }
}

fn fresh(notice: Notice) -> NoticeRecord {
    NoticeRecord {
        attempts: 0,
        due_ms: Some(notice.created_ms),
        ended_ms: None,
        error: None,
        notice,
    }
}

fn ended(job: u64) -> Change {
    Change::JobEnded {
        job: JobId(job),
        state: JobState::Cancelled,
        failure: None,
        ended_ms: 9,
    }
}

#[tokio::test]
async fn a_notice_is_kept_with_the_end_of_its_job_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    for kept in [
        Kept::Sqlite(folder.path()),
        Kept::Postgres(Postgres::shared().database()),
    ] {
        let store = kept.open().await;
        let told = notice("a", 1, false, 9);
        let submitted = vec![Change::JobSubmitted(head(1, Some("key")).into())];
        store.commit(0, submitted).await.unwrap();
        let (sequence, _) = store.load().await.unwrap();
        // The last change cannot be.
        let torn = vec![
            ended(1),
            Change::NoticeAdded(told.clone()),
            Change::JobSubmitted(head(2, Some("key")).into()),
        ];
        assert!(store.commit(sequence, torn).await.is_err());
        assert_eq!(store.due_notices(Millis::MAX / 2, 9).await.unwrap(), []);
        let whole = vec![ended(1), Change::NoticeAdded(told.clone())];
        store.commit(sequence, whole).await.unwrap();
        store.close().await;

        let store = kept.open().await;
        assert_eq!(store.due_notices(8, 9).await.unwrap(), [], "it is not due yet");
        assert_eq!(store.due_notices(9, 9).await.unwrap(), [fresh(told)]);
        store.close().await;
    }
}

#[tokio::test]
async fn notices_are_due_until_they_end_and_then_shown_until_they_are_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let all = [
            notice("a", 1, false, 1),
            notice("b", 2, false, 2),
            notice("c", 1, true, 3),
        ];
        let (sequence, _) = store.load().await.unwrap();
        let changes = all.iter().cloned().map(Change::NoticeAdded).collect();
        store.commit(sequence, changes).await.unwrap();
        let due = async |now, limit| {
            let records = store.due_notices(now, limit).await.unwrap();
            records.into_iter().map(|record| record.notice.id).collect::<Vec<_>>()
        };
        assert_eq!(due(3, 9).await, ["c", "a", "b"], "those of the farm first");
        assert_eq!(due(2, 9).await, ["a", "b"]);
        assert_eq!(due(3, 2).await, ["c", "a"]);

        let [a, b, c] = all.map(fresh);
        let again = NoticeRecord {
            attempts: 1,
            due_ms: Some(50),
            error: Some("no answer".into()),
            ..a
        };
        let arrived = NoticeRecord {
            attempts: 2,
            due_ms: None,
            ended_ms: Some(20),
            ..b
        };
        let given_up = NoticeRecord {
            due_ms: None,
            ended_ms: Some(30),
            error: Some("it was answered with 500".into()),
            ..c
        };
        for record in [&again, &arrived, &given_up] {
            store.keep_attempt(record.clone()).await.unwrap();
        }
        assert_eq!(due(49, 9).await, [""; 0]);
        assert_eq!(due(50, 9).await, ["a"]);

        let page = async |job: Option<u64>, before: Option<&str>, limit| {
            let page = store.notices(job.map(JobId), before.map(str::to_owned), limit).await;
            page.unwrap()
        };
        let everything = [given_up.clone(), arrived.clone(), again.clone()];
        assert_eq!(page(None, None, 9).await, everything);
        assert_eq!(page(None, None, 1).await, everything[..1]);
        assert_eq!(page(None, Some("c"), 9).await, everything[1..]);
        assert_eq!(page(Some(1), None, 9).await, [given_up.clone(), again.clone()]);
        assert_eq!(page(Some(1), Some("b"), 9).await, everything[2..]);
        assert_eq!(page(Some(3), None, 9).await, []);

        assert_eq!(store.forget_notices(20).await.unwrap(), 0);
        assert_eq!(store.forget_notices(30).await.unwrap(), 1);
        assert_eq!(page(None, None, 9).await, [given_up, again.clone()]);
        assert_eq!(store.forget_notices(1_000_000).await.unwrap(), 1);
        assert_eq!(page(None, None, 9).await, [again], "what is due is not forgotten");
    }
}
